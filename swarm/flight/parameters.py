"""Which autopilot parameters a tethered flight needs, and why: one table per autopilot.

Vehicles that hold one cable must not decide alone. No failsafe may return to launch; a lost stream
must end quickly; a lost ground station must end in landing, for all after the same time.
Values as documented for PX4 1.16 and ArduCopter 4.6.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swarm.certification.findings import Finding, Severity
from swarm.certification.stream_loss import (
    StreamLossCertificate,
    StreamLossModel,
    certify_stream_loss,
)
from swarm.mavlink.frames import AutopilotName
from swarm.mission import Vehicles
from swarm.mission.fleet import Fleet, Limits
from swarm.planning import Plan

Value = float
STREAM_LOSS_TIME = 0.5
GROUND_SYSTEM = 255.0
_HEADROOM = 1.2
"""Share of the plan's speed that an autopilot must allow: some is needed to catch up."""


@dataclass(frozen=True)
class Demands:
    """What a flight asks of every autopilot.

    Speeds in m/s (level, up, down), acceleration in m/s²; ``hold`` is the team's common time T in
    seconds after which vehicles without a ground station land, ``descent`` the speed at which all
    land, ``height`` in metres how high they fly at most; ``global_position`` says whether they know
    where on earth they are, so that Hold exists.
    """

    speed: float
    up: float
    down: float
    acceleration: float
    hold: float
    descent: float
    height: float
    global_position: bool


def demands_of(vehicles: Vehicles, fleet: Fleet) -> Demands:
    """Return what any mission with such vehicles may ask."""
    speed = vehicles.max_speed
    return _demands(fleet, speed, speed, speed, vehicles.max_acceleration, 0.0)


def demands_of_plan(plan: Plan, fleet: Fleet) -> Demands:
    """Return what a plan asks, by its motion."""
    position, velocity, acceleration = plan.motion.at(np.arange(0.0, plan.duration, 0.1))
    level = float(np.hypot(velocity[..., 0], velocity[..., 1]).max())
    up, down = float(velocity[..., 2].max()), float(-velocity[..., 2].min())
    braking = plan.mission.vehicles.braking_acceleration
    strongest = float(np.linalg.norm(acceleration, axis=-1).max()) + braking
    height = float(position[..., 2].max()) + plan.mission.vehicles.grip_offset
    return _demands(fleet, level, up, down, strongest, height)


def _demands(
    fleet: Fleet, speed: float, up: float, down: float, acceleration: float, height: float
) -> Demands:
    values = np.ceil(10.0 * np.array([speed, up, down, acceleration])) / 10.0
    speed, up, down, acceleration = values.tolist()
    return Demands(
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
    """What one parameter must be.

    ``good`` judges a value; ``should`` is what ``--fix`` sets, or makes of the present value;
    ``words`` say what is good. A rule with ``unless`` does not apply where that parameter has that
    value.
    """

    name: str
    good: Callable[[Value], bool]
    should: Value | Callable[[Value], Value]
    words: str
    why: str
    severity: Severity = "error"
    unless: tuple[str, Value] | None = None


@dataclass(frozen=True)
class Row:
    """One line of the audit's table: what is, what should be, why. ``value`` None: unknown."""

    system: int
    name: str
    value: Value | None
    should: Value
    words: str
    why: str
    severity: Severity

    @property
    def message(self) -> str:
        """The line in words."""
        now = "is not there" if self.value is None else f"is {self.value:g}"
        return f"system {self.system}: {self.name} {now}, should be {self.words}: {self.why}"


def _one_of(*values: float) -> Callable[[Value], bool]:
    return lambda value: any(abs(value - one) <= 1e-6 * max(1.0, abs(one)) for one in values)


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
_STREAM = "without setpoints it coasts until this runs out"
_TOGETHER = "nobody may decide earlier than the others: this is the fleet's limits.hold"
_PACE = "vehicles that land without the ground station must come down alike"
_HIGH = "above this they come down faster, and those below do not: levels would close in"
_GRIP = "one vehicle must not drop the cable on its own"


def rules(autopilot: AutopilotName, demands: Demands) -> tuple[Rule, ...]:
    """Return the rules for an autopilot that a flight makes such demands on."""
    return _px4(demands) if autopilot == "px4" else _ardupilot(demands)


def _px4(asked: Demands) -> tuple[Rule, ...]:
    speed, hold = _HEADROOM * asked.speed, float(round(asked.hold))
    lost = (
        Rule("COM_OBL_RC_ACT", _one_of(5), 5, "5 (hold)",
             "what follows when the setpoints end; all hold, and land together after T")
        if asked.global_position
        else Rule("COM_OBL_RC_ACT", _one_of(4, 5), 4, "4 (land) or 5 (hold)",
                  "what follows when the setpoints end; there is no hold without global position")
    )  # fmt: skip
    return (
        lost,
        Rule("COM_OF_LOSS_T", _most(STREAM_LOSS_TIME), STREAM_LOSS_TIME,
             f"at most {STREAM_LOSS_TIME:g} s", _STREAM),
        Rule("NAV_DLL_ACT", _one_of(3), 3, "3 (land)",
             "without the ground station everybody must land"),
        Rule("COM_DL_LOSS_T", _one_of(hold), hold, f"{hold:g} s", _TOGETHER),
        Rule("COM_FAIL_ACT_T", _one_of(0), 0, "0 s",
             "every failsafe waits this long first, and the others do not"),
        Rule("NAV_RCL_ACT", _one_of(1, 3), 3, "1 (hold) or 3 (land)", _ALONE),
        Rule("COM_RCL_EXCEPT", *_with_bit(2), "with bit 2 (offboard)",
             "offboard must not end because a remote control is off", "warning"),
        Rule("COM_LOW_BAT_ACT", _one_of(0, 2), 0, "0 (warn) or 2 (land)",
             "batteries are the group's decision"),
        Rule("COM_FLTT_LOW_ACT", _one_of(0, 1), 1, "0 or 1 (warn)", _ALONE),
        Rule("COM_POS_LOW_ACT", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_WIND_MAX_ACT", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE,
             "warning"),
        Rule("COM_IMB_PROP_ACT", _one_of(-1, 0, 2), 0, "not 1 (return)", _ALONE, "warning"),
        Rule("COM_ACT_FAIL_ACT", _one_of(0, 1, 2), 0, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_FLT_TIME_MAX", lambda value: value <= 0.0, -1, "-1 (no limit)",
             "it flies home when this time is over"),
        Rule("NAV_TRAFF_AVOID", _one_of(0, 1, 3, 4), 1, "not 2 (return)", _ALONE, "warning"),
        Rule("GF_ACTION", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_DISARM_PRFLT", _none_or_least(10.0), 10.0, "-1 or at least 10 s",
             "arming the team takes a few seconds"),
        Rule("LNDMC_TRIG_TIME", _least(1.0), 1.0, "at least 1 s",
             "a vehicle that the cable holds up must not be taken for landed", "warning"),
        Rule("LNDMC_Z_VEL_MAX", _most(0.25), 0.25, "at most 0.25 m/s",
             "a vehicle that the cable holds up must not be taken for landed", "warning"),
        Rule("MPC_LAND_SPEED", _one_of(asked.descent), asked.descent, f"{asked.descent:g} m/s",
             _PACE, "warning"),
        Rule("MPC_LAND_ALT2", _least(asked.height), max(5.0, asked.height),
             f"at least {asked.height:g} m", _HIGH, "warning"),
        Rule("MPC_LAND_ALT1", _least(asked.height), max(10.0, asked.height + 1.0),
             f"at least {asked.height:g} m", _HIGH, "warning"),
        Rule("MPC_XY_VEL_MAX", _least(speed), max(12.0, speed), f"at least {speed:.1f} m/s",
             "the plan's speed and some to catch up"),
        Rule("MPC_Z_VEL_MAX_UP", _least(asked.up), max(3.0, asked.up),
             f"at least {asked.up:.1f} m/s", "the plan's speed", "warning"),
        Rule("MPC_Z_VEL_MAX_DN", _least(asked.down), max(1.5, asked.down),
             f"at least {asked.down:.1f} m/s", "the plan's speed", "warning"),
        Rule("MPC_ACC_HOR", _least(asked.acceleration), max(3.0, asked.acceleration),
             f"at least {asked.acceleration:.1f} m/s²", "the plan's acceleration", "warning"),
    )  # fmt: skip


def _ardupilot(asked: Demands) -> tuple[Rule, ...]:
    level, up, down = (100.0 * _HEADROOM * asked.speed, 100.0 * asked.up, 100.0 * asked.down)
    hold, pull, descent = asked.hold, 100.0 * asked.acceleration, round(100.0 * asked.descent)
    low = 100.0 * asked.height
    return (
        Rule("GUID_TIMEOUT", _most(STREAM_LOSS_TIME), STREAM_LOSS_TIME,
             f"at most {STREAM_LOSS_TIME:g} s", _STREAM),
        Rule("FS_GCS_ENABLE", _one_of(5), 5, "5 (land)",
             "without the ground station everybody must land"),
        Rule("FS_GCS_TIMEOUT", _one_of(hold), hold, f"{hold:g} s", _TOGETHER),
        Rule("FS_THR_ENABLE", _one_of(0, 3), 3, "0 or 3 (land)", _ALONE),
        Rule("FS_OPTIONS", lambda value: int(value) & 36 == 4,
             lambda value: float(int(value) & ~32 | 4),
             "with bit 2 (guided goes on), without bit 5 (release gripper)",
             "a remote control that is off must not end guided, and nobody drops the cable alone"),
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
             "the plan's speed and some to catch up", "warning"),
        Rule("WPNAV_SPEED_UP", _least(up), max(250.0, up), f"at least {up:.0f} cm/s",
             "the plan's speed", "warning"),
        Rule("WPNAV_SPEED_DN", _least(down), max(150.0, down), f"at least {down:.0f} cm/s",
             "the plan's speed", "warning"),
        Rule("WPNAV_ACCEL", _least(pull), max(250.0, pull), f"at least {pull:.0f} cm/s²",
             "the plan's acceleration", "warning"),
        Rule("SYSID_MYGCS", _one_of(GROUND_SYSTEM), GROUND_SYSTEM, f"{GROUND_SYSTEM:g}",
             "it only obeys the ground station that this names", "warning"),
    )  # fmt: skip


def judge(
    system: int, values: Mapping[str, Value], wanted: Sequence[Rule]
) -> tuple[list[Row], list[Row]]:
    """Return the rows that are wrong and the rows that are good, in the table's order.

    A parameter that the vehicle does not have is a warning: firmware differs.
    """
    wrong: list[Row] = []
    good: list[Row] = []
    for rule in wanted:
        if rule.unless is not None and values.get(rule.unless[0]) == rule.unless[1]:
            continue
        value = values.get(rule.name)
        fine = value is not None and rule.good(value)
        severity: Severity = "info" if fine else "warning" if value is None else rule.severity
        should = rule.should if isinstance(rule.should, int | float) else rule.should(value or 0.0)
        row = Row(system, rule.name, value, should, rule.words, rule.why, severity)
        (good if fine else wrong).append(row)
    return wrong, good


def stream_loss_model(
    vehicles: Sequence[tuple[AutopilotName, Mapping[str, Value]]], limits: Limits
) -> StreamLossModel:
    """Return how vehicles coast by what their parameters are, in order along the cable.

    A parameter that a vehicle does not tell counts as the longest that passes the audit. One that
    lands when its setpoints end comes down until it has been noticed.
    """
    names = {"px4": "COM_OF_LOSS_T", "ardupilot": "GUID_TIMEOUT"}
    timeout = tuple(float(values.get(names[one], STREAM_LOSS_TIME)) for one, values in vehicles)
    lands = [one == "px4" and values.get("COM_OBL_RC_ACT") == 4.0 for one, values in vehicles]
    descent = tuple(limits.silence * limits.descent if one else 0.0 for one in lands)
    return StreamLossModel(timeout, limits.silence, descent)


def stream_loss_findings(
    plan: Plan, model: StreamLossModel
) -> tuple[StreamLossCertificate, list[Finding]]:
    """Return what these vehicles do to a plan when their setpoints end, and findings on it."""
    found = certify_stream_loss(plan, model)
    findings = found.findings()
    lands = [descent > 0.0 for descent in model.descent]
    if any(lands) and not all(lands):
        who = ", ".join(f"vehicle {k}" for k, one in enumerate(lands, 1) if one)
        words = f"when all setpoints end, {who} would land at once and the others hold: they part"
        findings.append(Finding("error", "stream loss", words))
    return found, findings
