"""How vehicles with real firmware know their position: parameters of ``--positioning``."""

from collections.abc import Mapping
from typing import Literal

from sitl.world import Capture, Kind

Positioning = Literal["gps", "rtk", "mocap"]

_RECEIVER: dict[str, float] = {
    # The simulated receiver is late by 0.16 s; the default for its kind (0.12 s) leaves 0.05 s of
    # delay in the estimate.
    "GPS1_DELAY_MS": 160,
}
_ARDUPILOT: Mapping[Positioning, Mapping[str, float]] = {
    # ArduPilot's simulated receiver as it is: 5 Hz, and an estimator that trusts it little. With
    # it, the drift of the simulated gyroscopes makes velocities wrong by 0.025 m/s.
    "gps": _RECEIVER,
    "rtk": _RECEIVER
    | {
        "SIM_GPS_HZ": 10,
        "SIM_GPS_ACC": 0.02,
        "GPS1_RATE_MS": 100,
        "EK3_POSNE_M_NSE": 0.1,
        "EK3_VELNE_M_NSE": 0.1,
    },
    "mocap": {
        "SIM_GPS_DISABLE": 1,
        "GPS1_TYPE": 0,
        "COMPASS_ENABLE": 0,  # the heading comes from motion capture
        "EK3_SRC1_POSXY": 6,
        "EK3_SRC1_VELXY": 0,
        "EK3_SRC1_POSZ": 6,
        "EK3_SRC1_VELZ": 0,
        "EK3_SRC1_YAW": 6,
        "VISO_TYPE": 1,  # MAVLink
        "VISO_YAW_M_NSE": 0.05,
    },
}
_PX4: Mapping[Positioning, Mapping[str, float]] = {
    # PX4's defaults are those of a receiver without correction data; the simulated one has no delay
    "rtk": {"EKF2_GPS_P_NOISE": 0.02, "EKF2_GPS_V_NOISE": 0.1, "EKF2_GPS_DELAY": 0},
    "mocap": {
        "SYS_HAS_GPS": 0,
        "EKF2_GPS_CTRL": 0,
        "EKF2_BARO_CTRL": 0,  # its noise is a hundred times that of motion capture
        "EKF2_MAG_TYPE": 5,  # none: the heading comes from motion capture
        "EKF2_HGT_REF": 3,
        "EKF2_EV_CTRL": 11,  # position, height and yaw
        "EKF2_EV_NOISE_MD": 1,  # the poses have no covariance
        "EKF2_EVA_NOISE": 0.05,
    },
}

_TRUSTED: dict[Kind, float] = {"ardupilot": 0.05, "px4": 0.01}
"""Least noise of positions that an estimator is told, metres: the attitude of a pose errs too."""


def usable(kind: Kind, positioning: Positioning) -> bool:
    """Return whether vehicles with this firmware can know their position so."""
    return positioning in (_PX4 if kind == "px4" else _ARDUPILOT)


def parameters(kind: Kind, positioning: Positioning, capture: Capture) -> dict[str, float]:
    """Return the parameters for a source of positions; ``capture`` is the world's system."""
    if kind == "px4":
        values, delay, noise = dict(_PX4[positioning]), "EKF2_EV_DELAY", "EKF2_EVP_NOISE"
    else:
        values, delay, noise = dict(_ARDUPILOT[positioning]), "VISO_DELAY_MS", "VISO_POS_M_NSE"
    if positioning == "mocap":
        values |= {delay: round(1e3 * capture.delay), noise: max(_TRUSTED[kind], capture.noise)}
    return values
