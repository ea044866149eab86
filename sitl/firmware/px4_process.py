"""Processes of real PX4 firmware: their command, environment and parameters."""

import math
import os

from sitl.firmware import positioning, px4_hil
from sitl.firmware.process import Launch, Need, Start
from sitl.firmware.selection import PX4_PROGRAM

_AIRFRAME = "10016"
"""PX4's quadrotor X whose physics come through the simulator link (``none_iris``)."""
_LOCAL = 14580
"""UDP port of instance 0's link to a ground station; instance i uses the i-th after it."""
_OWN = (18570, _LOCAL, 14280, 13030)
"""UDP ports of instance 0's links by its own startup script."""

_PARAMETERS: dict[str, float] = {
    "IMU_INTEG_RATE": 200,  # the rate of the sensor values
    "THR_MDL_FAC": 0.65,  # the curve of `sitl.physics.rigid`
    "MPC_THR_HOVER": 0.39,  # weight over full thrust of the default vehicle
    # Tuned for the default vehicle, as every real one must be: see ArduPilot's in `process`.
    "MC_ROLL_P": 8,
    "MC_PITCH_P": 8,
    "MC_ROLLRATE_P": 0.33,
    "MC_PITCHRATE_P": 0.33,
    "MC_ROLLRATE_I": 1.0,
    "MC_PITCHRATE_I": 1.0,
    "MC_ROLLRATE_D": 0.006,
    "MC_PITCHRATE_D": 0.006,
    "MC_RR_INT_LIM": 0.5,
    "MC_PR_INT_LIM": 0.5,
    # Stiff enough for a cable: with PX4's defaults (0.95, 1.8, 0.4, 1, 4, 2) nine were up to 0.17 m
    # low as they lifted it, and 0.09 m behind on a circle of 1 m at 0.5 m/s (0.05 m with these).
    "MPC_XY_P": 1.5,
    "MPC_XY_VEL_P_ACC": 3.5,
    "MPC_XY_VEL_I_ACC": 1.5,
    "MPC_Z_P": 1.5,
    "MPC_Z_VEL_P_ACC": 8,
    "MPC_Z_VEL_I_ACC": 3,
    "SIM_BAT_DRAIN": 900,  # seconds, as the emulated vehicles
    "SDLOG_MODE": -1,  # no log: in SITL it has the whole estimator at 100 Hz, 20 MB a minute
}
_GRIPPER: dict[str, float] = {"PD_GRIPPER_TYPE": 0, "PD_GRIPPER_TO": 1, "PWM_MAIN_FUNC5": 430}
"""A gripper on output 5, which has moved after a second."""


def launch(start: Start, radius: float) -> Launch:
    """Return the process of one PX4; ``radius`` is that of the vehicle's disc in metres.

    PX4's instance is the system id less one. Variables ``PX4_PARAM_…`` set parameters before its
    startup script sets its own defaults; the file ``px4-rc.mavlink``, which PX4 finds by its path
    as the user's own choice of links, sets those of the flight after that: a value that was equal
    to the first default would follow the second (COM_LOW_BAT_ACT: 0, then 3).
    """
    build, instance = start.binary, start.instance
    values = (
        _PARAMETERS
        | positioning.parameters("px4", start.positioning, start.capture)
        | _rotors(radius)
        | (_GRIPPER if start.gripper else {})
    )
    return Launch(
        [str(build / PX4_PROGRAM), "-d", "-i", str(instance), str(build / "etc")],
        start.folder,
        {"px4-rc.mavlink": _links(start)},
        [
            Need("TCP", px4_hil.PORT + instance, "127.0.0.1"),
            *(Need("UDP", one + instance) for one in (_OWN if start.target is None else [_LOCAL])),
        ],
        {
            "PX4_SIM_MODEL": "none_iris",
            "PX4_SYS_AUTOSTART": _AIRFRAME,
            "PATH": f"{start.folder}:{os.environ.get('PATH', os.defpath)}",
            **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in values.items()},
        },
    )


def _links(start: Start) -> str:
    """Return the script that sets the flight's parameters and starts the MAVLink links."""
    lines = [f"param set {name} {value:g}" for name, value in start.parameters.items()]
    if start.target is None:
        lines.append(". etc/init.d-posix/px4-rc.mavlink")
    else:
        host, _, port = start.target.rpartition(":")
        local = _LOCAL + start.instance
        lines.append(f"mavlink start -x -u {local} -r 4000000 -f -m onboard -o {port} -t {host}")
    return "\n".join(lines) + "\n"


def _rotors(radius: float) -> dict[str, float]:
    """Return the places of the motors of `sitl.physics.rigid`, metres forward and right."""
    arm = 0.7 * radius * math.sqrt(0.5)
    places = ((arm, arm), (-arm, -arm), (arm, -arm), (-arm, arm))
    return {
        f"CA_ROTOR{i}_P{axis}": value
        for i, place in enumerate(places)
        for axis, value in zip("XY", place, strict=True)
    }
