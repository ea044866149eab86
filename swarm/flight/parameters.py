"""The autopilot parameters that a tethered flight requires, and why: one table per autopilot.

Vehicles that hold one cable must not decide alone. No failsafe may return to launch; a lost stream
must end quickly; a lost ground station must end in landing, for all after the same time.
Values as documented for PX4 1.16 and ArduCopter 4.6.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm.certification.assessment import endurance_findings
from swarm.certification.clearances import PlanChecks
from swarm.certification.findings import Finding, Severity
from swarm.certification.stream_loss import (
    StreamLossCertificate,
    StreamLossModel,
)
from swarm.flight.flight_plan import FlightPlan
from swarm.mavlink.frames import AutopilotName
from swarm.mission import Vehicles
from swarm.mission.fleet import Fleet, Limits
from swarm.planning import Plan

Value = float
STREAM_LOSS_TIME = 0.5
"""Seconds without setpoints after which an autopilot must hold: COM_OF_LOSS_T, GUID_TIMEOUT. It is
half of PX4's default, since vehicles coast until then."""
GROUND_SYSTEM = 255.0
"""System id of a ground station, by convention of MAVLink; as a parameter it is a float."""
PX4_LATE = 2.0
"""Seconds by which PX4 misses the ground station later than after COM_DL_LOSS_T, a whole number: it
counts a link as alive for 1.25 to 2.5 s after its last heartbeat, and from then on the parameter's
time (``mavlink_receiver.cpp``, ``Commander.cpp``; 2.4 and 2.5 s were measured)."""
ARDUPILOT_LATE = 4.0
"""Seconds for which an ArduCopter hovers in LAND before it descends, if a failsafe chose the mode
(``LAND_WITH_DELAY_MS``; measured: half a metre lower 5.3 s after its failsafe, 1.3 s after a
command)."""
_HEADROOM = 1.2
"""Speed that an autopilot must allow per planned speed, so that a vehicle can catch up."""


@dataclass(frozen=True)
class Requirements:
    """The requirements of a flight on every autopilot.

    Speeds in m/s (level, up, down), acceleration in m/s²; ``hold`` is the team's common time T in
    seconds after which vehicles without a ground station land, ``descent`` the speed at which all
    land, ``height`` the largest height in metres; ``global_position`` says whether they have a
    global position, so that Hold exists.
    """

    speed: float
    up: float
    down: float
    acceleration: float
    hold: float
    descent: float
    height: float
    global_position: bool


def fleet_requirements(vehicles: Vehicles, fleet: Fleet) -> Requirements:
    """Return the requirements of any mission with such vehicles."""
    speed = vehicles.max_speed
    return _rounded(fleet, speed, speed, speed, vehicles.max_acceleration, 0.0)


def plan_requirements(plan: Plan, fleet: Fleet) -> Requirements:
    """Return the requirements of a plan, from its motion."""
    position, velocity, acceleration = plan.motion.at(np.arange(0.0, plan.duration, 0.1))
    level = float(np.hypot(velocity[..., 0], velocity[..., 1]).max())
    up, down = float(velocity[..., 2].max()), float(-velocity[..., 2].min())
    braking = plan.mission.vehicles.braking_acceleration
    strongest = float(np.linalg.norm(acceleration, axis=-1).max()) + braking
    height = float(position[..., 2].max()) + plan.mission.vehicles.grip_offset
    return _rounded(fleet, level, up, down, strongest, height)


def _rounded(
    fleet: Fleet, speed: float, up: float, down: float, acceleration: float, height: float
) -> Requirements:
    values = np.ceil(10.0 * np.array([speed, up, down, acceleration])) / 10.0
    speed, up, down, acceleration = values.tolist()
    return Requirements(
        speed,
        up,
        down,
        acceleration,
        fleet.limits.hold,
        fleet.limits.descent,
        float(np.ceil(height)),
        fleet.frame != "shared",
    )


@dataclass(frozen=True)
class Rule:
    """The requirement on one parameter.

    ``good`` accepts a value; ``should`` is the value that ``--fix`` sets, or a function of the
    present one; ``words`` name the accepted values. A rule with ``unless`` does not apply where
    that parameter has that value.
    """

    name: str
    good: Callable[[Value], bool]
    should: Value | Callable[[Value], Value]
    words: str
    why: str
    severity: Severity = "error"
    unless: tuple[str, Value] | None = None


@dataclass(frozen=True)
class ParameterResult:
    """One line of the audit's table: present value (None: unknown), required value, reason."""

    system: int
    name: str
    value: Value | None
    should: Value
    words: str
    why: str
    severity: Severity

    @property
    def message(self) -> str:
        """The line as a message."""
        now = "is missing" if self.value is None else f"is {self.value:g}"
        return f"system {self.system}: {self.name} {now}, should be {self.words}: {self.why}"


def _one_of(*values: float) -> Callable[[Value], bool]:
    return lambda value: any(abs(value - good) <= 1e-6 * max(1.0, abs(good)) for good in values)


def _least(bound: float) -> Callable[[Value], bool]:
    return lambda value: value >= bound - 1e-6


def _most(bound: float) -> Callable[[Value], bool]:
    return lambda value: 0.0 < value <= bound + 1e-6


def _none_or_least(bound: float) -> Callable[[Value], bool]:
    return lambda value: value <= 0.0 or value >= bound - 1e-6


def _with_bit(bit: int) -> tuple[Callable[[Value], bool], Callable[[Value], Value]]:
    return lambda value: bool(int(value) >> bit & 1), lambda value: float(int(value) | 1 << bit)


def _without_bit(bit: int) -> tuple[Callable[[Value], bool], Callable[[Value], Value]]:
    return lambda value: not int(value) >> bit & 1, lambda value: float(int(value) & ~(1 << bit))


_ALONE = "a vehicle must not fly home on its own while it holds the cable"
_STREAM = "without setpoints the vehicle flies on for this time"
_TOGETHER = "no vehicle may decide earlier than the others: this is the fleet's limits.hold"
_PACE = "vehicles that land without the ground station must descend at one speed"
_HIGH = "above this height the descent is faster: vertical distances would change"
_CAPTURE = "without a receiver, positions and headings come from motion capture"
_GRIP = "one vehicle must not drop the cable on its own"


def rules(autopilot: AutopilotName, requirements: Requirements) -> tuple[Rule, ...]:
    """Return the rules for an autopilot under these requirements."""
    return _px4(requirements) if autopilot == "px4" else _ardupilot(requirements)


def _px4(required: Requirements) -> tuple[Rule, ...]:
    speed = _HEADROOM * required.speed
    alone = float(round(required.hold - PX4_LATE))
    lost = (
        Rule("COM_OBL_RC_ACT", _one_of(5), 5, "5 (hold)",
             "what follows when the setpoints end; all hold, and land together after T")
        if required.global_position
        else Rule("COM_OBL_RC_ACT", _one_of(4, 5), 4, "4 (land) or 5 (hold)",
                  "what follows when the setpoints end; there is no hold without global position")
    )  # fmt: skip
    return (
        *(() if required.global_position else _EXTERNAL_PX4),
        lost,
        Rule("COM_OF_LOSS_T", _most(STREAM_LOSS_TIME), STREAM_LOSS_TIME,
             f"at most {STREAM_LOSS_TIME:g} s", _STREAM),
        Rule("NAV_DLL_ACT", _one_of(3), 3, "3 (land)",
             "without the ground station all must land"),
        Rule("COM_DL_LOSS_T", _one_of(alone), alone, f"{alone:g} s", _TOGETHER),
        Rule("COM_FAIL_ACT_T", _one_of(0), 0, "0 s",
             "every failsafe waits this long first, and the others do not"),
        Rule("NAV_RCL_ACT", _one_of(1, 3), 3, "1 (hold) or 3 (land)", _ALONE),
        Rule("COM_RCL_EXCEPT", *_with_bit(2), "with bit 2 (offboard)",
             "a remote control that is off must not end offboard", "warning"),
        Rule("COM_LOW_BAT_ACT", _one_of(0, 2), 0, "0 (warn) or 2 (land)",
             "the team decides about batteries"),
        Rule("COM_FLTT_LOW_ACT", _one_of(0, 1), 1, "0 or 1 (warn)", _ALONE),
        Rule("COM_POS_LOW_ACT", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_WIND_MAX_ACT", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE,
             "warning"),
        Rule("COM_IMB_PROP_ACT", _one_of(-1, 0, 2), 0, "not 1 (return)", _ALONE, "warning"),
        Rule("COM_ACT_FAIL_ACT", _one_of(0, 1, 2), 0, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_FLT_TIME_MAX", lambda value: value <= 0.0, -1, "-1 (no limit)",
             "the vehicle returns when this time is over"),
        Rule("NAV_TRAFF_AVOID", _one_of(0, 1, 3, 4), 1, "not 2 (return)", _ALONE, "warning"),
        Rule("GF_ACTION", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_DISARM_PRFLT", _none_or_least(10.0), 10.0, "-1 or at least 10 s",
             "arming the team takes a few seconds"),
        Rule("LNDMC_TRIG_TIME", _least(1.0), 1.0, "at least 1 s",
             "a vehicle that the cable holds up must not be taken for landed", "warning"),
        Rule("LNDMC_Z_VEL_MAX", _most(0.25), 0.25, "at most 0.25 m/s",
             "a vehicle that the cable holds up must not be taken for landed", "warning"),
        Rule("MPC_LAND_SPEED", _one_of(required.descent), required.descent,
             f"{required.descent:g} m/s", _PACE, "warning"),
        Rule("MPC_LAND_ALT2", _least(required.height), max(5.0, required.height),
             f"at least {required.height:g} m", _HIGH, "warning"),
        Rule("MPC_LAND_ALT1", _least(required.height), max(10.0, required.height + 1.0),
             f"at least {required.height:g} m", _HIGH, "warning"),
        Rule("MPC_XY_VEL_MAX", _least(speed), max(12.0, speed), f"at least {speed:.1f} m/s",
             "the plan's speed, and a reserve to catch up"),
        Rule("MPC_Z_VEL_MAX_UP", _least(required.up), max(3.0, required.up),
             f"at least {required.up:.1f} m/s", "the plan's speed", "warning"),
        Rule("MPC_Z_VEL_MAX_DN", _least(required.down), max(1.5, required.down),
             f"at least {required.down:.1f} m/s", "the plan's speed", "warning"),
        Rule("MPC_ACC_HOR", _least(required.acceleration), max(3.0, required.acceleration),
             f"at least {required.acceleration:.1f} m/s²", "the plan's acceleration", "warning"),
    )  # fmt: skip


def _ardupilot(required: Requirements) -> tuple[Rule, ...]:
    level, up, down = (
        100.0 * _HEADROOM * required.speed,
        100.0 * required.up,
        100.0 * required.down,
    )
    hold, pull, descent = (
        required.hold,
        100.0 * required.acceleration,
        round(100.0 * required.descent),
    )
    low, alone = 100.0 * required.height, hold - ARDUPILOT_LATE
    return (
        *(() if required.global_position else _EXTERNAL),
        Rule("GUID_TIMEOUT", _most(STREAM_LOSS_TIME), STREAM_LOSS_TIME,
             f"at most {STREAM_LOSS_TIME:g} s", _STREAM),
        Rule("FS_GCS_ENABLE", _one_of(5), 5, "5 (land)",
             "without the ground station all must land"),
        Rule("FS_GCS_TIMEOUT", _one_of(alone), alone, f"{alone:g} s", _TOGETHER),
        Rule("FS_THR_ENABLE", _one_of(0, 3), 3, "0 or 3 (land)", _ALONE),
        Rule("FS_OPTIONS", lambda value: int(value) & 36 == 4,
             lambda value: float(int(value) & ~32 | 4),
             "with bit 2 (guided goes on), without bit 5 (release gripper)",
             "a remote control that is off must not end guided, and no vehicle may release the "
             "cable alone"),
        Rule("FLIGHT_OPTIONS", *_without_bit(2), "without bit 2 (release gripper)", _GRIP),
        Rule("BATT_FS_LOW_ACT", _one_of(0, 1), 0, "0 (warn) or 1 (land)", _ALONE),
        Rule("BATT_FS_CRT_ACT", _one_of(0, 1), 0, "0 (warn) or 1 (land)", _ALONE),
        Rule("FS_EKF_ACTION", _one_of(1, 2, 3), 1, "1 to 3 (land or altitude hold)", _ALONE),
        Rule("FS_DR_ENABLE", _one_of(0, 1), 1, "0 or 1 (land)", _ALONE),
        Rule("FENCE_ACTION", _one_of(0, 2), 0, "0 (report) or 2 (land)", _ALONE,
             unless=("FENCE_ENABLE", 0.0)),
        Rule("DISARM_DELAY", _none_or_least(10.0), 10.0,
             "0 or at least 10 s", "arming the team takes a few seconds"),
        Rule("LAND_SPEED", _one_of(descent), descent, f"{descent:g} cm/s", _PACE, "warning"),
        Rule("LAND_ALT_LOW", _least(low), max(1000.0, low), f"at least {low:.0f} cm", _HIGH,
             "warning"),
        Rule("WPNAV_SPEED", _least(level), max(1000.0, level), f"at least {level:.0f} cm/s",
             "the plan's speed, and a reserve to catch up", "warning"),
        Rule("WPNAV_SPEED_UP", _least(up), max(250.0, up), f"at least {up:.0f} cm/s",
             "the plan's speed", "warning"),
        Rule("WPNAV_SPEED_DN", _least(down), max(150.0, down), f"at least {down:.0f} cm/s",
             "the plan's speed", "warning"),
        Rule("WPNAV_ACCEL", _least(pull), max(250.0, pull), f"at least {pull:.0f} cm/s²",
             "the plan's acceleration", "warning"),
        Rule("SYSID_MYGCS", _one_of(GROUND_SYSTEM), GROUND_SYSTEM, f"{GROUND_SYSTEM:g}",
             "the vehicle obeys only the ground station with this system id", "warning"),
    )  # fmt: skip


_EXTERNAL = (
    Rule("EK3_SRC1_POSXY", _one_of(6), 6, "6 (external navigation)", _CAPTURE, "warning"),
    Rule("EK3_SRC1_POSZ", _one_of(6), 6, "6 (external navigation)", _CAPTURE, "warning"),
    Rule("EK3_SRC1_YAW", _one_of(6), 6, "6 (external navigation)", _CAPTURE, "warning"),
    Rule("EK3_SRC1_VELXY", _one_of(0, 6), 0, "0 (none) or 6 (external navigation)", _CAPTURE,
         "warning"),
    Rule("EK3_SRC1_VELZ", _one_of(0, 6), 0, "0 (none) or 6 (external navigation)", _CAPTURE,
         "warning"),
    Rule("VISO_TYPE", _one_of(1), 1, "1 (MAVLink)", _CAPTURE, "warning"),
)  # fmt: skip
"""ArduPilot's sources where the fleet has one shared frame."""
_POSE = 0b1011
"""EKF2_EV_CTRL: horizontal position, height, yaw."""
_EXTERNAL_PX4 = (
    Rule("EKF2_EV_CTRL", lambda value: int(value) & _POSE == _POSE,
         lambda value: float(int(value) | _POSE), "with bits 0, 1 and 3 (position, height, yaw)",
         _CAPTURE, "warning"),
    Rule("EKF2_HGT_REF", _one_of(3), 3, "3 (vision)", _CAPTURE, "warning"),
    Rule("EKF2_GPS_CTRL", _one_of(0), 0, "0 (none)", _CAPTURE, "warning"),
)  # fmt: skip
"""PX4's, likewise."""


def required_values(autopilot: AutopilotName, requirements: Requirements) -> dict[str, Value]:
    """Return the parameters that an autopilot with default parameters needs, and their values."""
    return {
        rule.name: rule.should if isinstance(rule.should, int | float) else rule.should(0.0)
        for rule in rules(autopilot, requirements)
    }


def start_as_required(world: Mapping[str, Any], requirements: Requirements) -> None:
    """Let the vehicles of an emulator's world start with the parameters that are required."""
    for vehicle in world["vehicles"]:
        vehicle["parameters"] = required_values(vehicle["autopilot"], requirements)


def evaluate(
    system: int, values: Mapping[str, Value], rules_: Sequence[Rule]
) -> tuple[list[ParameterResult], list[ParameterResult]]:
    """Return the wrong and the good parameters, in the table's order.

    A parameter that the vehicle does not have is a warning: firmware differs.
    """
    wrong: list[ParameterResult] = []
    good: list[ParameterResult] = []
    for rule in rules_:
        if rule.unless is not None and values.get(rule.unless[0]) == rule.unless[1]:
            continue
        value = values.get(rule.name)
        known = value if value is not None and math.isfinite(value) else None
        fine = known is not None and rule.good(known)
        severity: Severity = "info" if fine else "warning" if value is None else rule.severity
        should = rule.should if isinstance(rule.should, int | float) else rule.should(known or 0.0)
        row = ParameterResult(system, rule.name, value, should, rule.words, rule.why, severity)
        (good if fine else wrong).append(row)
    return wrong, good


def stream_loss_model(
    vehicles: Sequence[tuple[str, Mapping[str, Value]]], limits: Limits
) -> StreamLossModel:
    """Return the stream-loss model of vehicles with these autopilots and parameters, in order.

    A parameter that is not known counts as the longest time that passes the audit. A vehicle that
    lands when its setpoints end descends until that is detected.
    """
    names = {"px4": "COM_OF_LOSS_T", "ardupilot": "GUID_TIMEOUT"}
    times = [float(values.get(names.get(kind, ""), STREAM_LOSS_TIME)) for kind, values in vehicles]
    timeout = tuple(time if math.isfinite(time) else STREAM_LOSS_TIME for time in times)
    lands = [kind == "px4" and values.get("COM_OBL_RC_ACT") == 4.0 for kind, values in vehicles]
    descent = tuple(limits.silence * limits.descent if at_once else 0.0 for at_once in lands)
    returns = tuple(kind == "ardupilot" for kind, _ in vehicles)
    return StreamLossModel(timeout, limits.silence, descent, returns).shortest


def stream_loss_of(
    flight_plan: FlightPlan,
    model: StreamLossModel,
    progress: Callable[[float], None] = lambda _: None,
) -> StreamLossCertificate:
    """Return the certificate of a plan for lost setpoints of these vehicles.

    It is the plan's own where that was computed for such vehicles; for others it may take minutes,
    and ``progress`` is called with the completed share.
    """
    certified = flight_plan.stream_loss
    if certified is not None and certified.holds_for(flight_plan.plan, model):
        return certified
    return PlanChecks.of(flight_plan.plan).stream_loss(model, progress)


def stream_loss_findings(
    flight_plan: FlightPlan,
    model: StreamLossModel,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[StreamLossCertificate, list[Finding]]:
    """Return :func:`stream_loss_of` these vehicles, with findings."""
    certificate, plan = stream_loss_of(flight_plan, model, progress), flight_plan.plan
    findings = certificate.findings()
    if certificate.delay:
        findings.extend(endurance_findings(plan, certificate.delay))
    lands = [descent > 0.0 for descent in model.descent]
    if any(lands) and not all(lands):
        who = ", ".join(f"vehicle {k}" for k, lands_alone in enumerate(lands, 1) if lands_alone)
        words = f"when all setpoints end, {who} would land at once and the others would hold"
        findings.append(Finding("error", "stream loss", words))
    return certificate, findings
