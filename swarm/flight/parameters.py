"""Which autopilot parameters a tethered flight needs, and why: one table per autopilot.

Vehicles that hold one cable must not decide alone. No failsafe may return to launch; a lost stream
must end quickly; a lost ground station must end in landing, for all after the same time.
Values as documented for PX4 1.16 and ArduCopter 4.6.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from swarm.mavlink.frames import Projection
from swarm.mission import Vehicles
from swarm.preflight.findings import Severity

Value = float
GROUND_LOSS_TIME = 10.0
"""The team's common T in seconds: after it, vehicles without a ground station land."""
STREAM_LOSS_TIME = 0.5
GROUND_SYSTEM = 255.0


@dataclass(frozen=True)
class Rule:
    """What one parameter must be.

    ``good`` judges a value; ``should`` is what ``--fix`` sets; ``words`` say what is good. A rule
    with ``unless`` does not apply where that parameter has that value.
    """

    name: str
    good: Callable[[Value], bool]
    should: Value
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
    return lambda value: value in values


def _least(bound: float) -> Callable[[Value], bool]:
    return lambda value: value >= bound - 1e-6


def _most(bound: float) -> Callable[[Value], bool]:
    return lambda value: 0.0 < value <= bound + 1e-6


_ALONE = "a vehicle must not fly home on its own while it holds the cable"
_STREAM = "without setpoints it coasts until this runs out"


def rules(autopilot: Projection, vehicles: Vehicles) -> tuple[Rule, ...]:
    """Return the rules for an autopilot that flies such vehicles."""
    return _px4(vehicles) if autopilot == "px4" else _ardupilot()


def _px4(vehicles: Vehicles) -> tuple[Rule, ...]:
    speed, thrust = vehicles.max_speed, vehicles.max_acceleration
    return (
        Rule("COM_OBL_RC_ACT", _one_of(4, 5), 4, "4 (land) or 5 (hold)",
             "what follows when the setpoints end; 0 without a remote control descends blind"),
        Rule("COM_OF_LOSS_T", _most(STREAM_LOSS_TIME), STREAM_LOSS_TIME,
             f"at most {STREAM_LOSS_TIME:g} s", _STREAM),
        Rule("NAV_DLL_ACT", _one_of(3), 3, "3 (land)",
             "without the ground station everybody must land"),
        Rule("COM_DL_LOSS_T", _one_of(GROUND_LOSS_TIME), GROUND_LOSS_TIME,
             f"{GROUND_LOSS_TIME:g} s", "nobody may decide earlier than the others"),
        Rule("NAV_RCL_ACT", _one_of(1, 3), 3, "1 (hold) or 3 (land)", _ALONE),
        Rule("COM_RCL_EXCEPT", lambda value: bool(int(value) & 4), 4, "with bit 2 (offboard)",
             "offboard must not end because a remote control is off", "warning"),
        Rule("COM_LOW_BAT_ACT", _one_of(0, 2), 0, "0 (warn) or 2 (land)",
             "batteries are the group's decision"),
        Rule("COM_FLTT_LOW_ACT", _one_of(0, 1), 1, "0 or 1 (warn)", _ALONE),
        Rule("COM_POS_LOW_ACT", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_WIND_MAX_ACT", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE,
             "warning"),
        Rule("COM_IMB_PROP_ACT", _one_of(-1, 0, 2), 0, "not 1 (return)", _ALONE, "warning"),
        Rule("GF_ACTION", _one_of(0, 1, 2, 5), 1, "not 3 (return) or 4 (terminate)", _ALONE),
        Rule("COM_DISARM_PRFLT", _least(10.0), 10.0, "at least 10 s",
             "arming the team takes a few seconds"),
        Rule("MPC_XY_VEL_MAX", _least(1.2 * speed), max(12.0, 1.2 * speed),
             f"at least {1.2 * speed:g} m/s", "the plan's speed and some to catch up"),
        Rule("MPC_Z_VEL_MAX_UP", _least(speed), max(3.0, speed), f"at least {speed:g} m/s",
             "the plan's speed", "warning"),
        Rule("MPC_Z_VEL_MAX_DN", _least(speed), max(1.5, speed), f"at least {speed:g} m/s",
             "the plan's speed", "warning"),
        Rule("MPC_ACC_HOR", _least(thrust), max(3.0, thrust), f"at least {thrust:g} m/s²",
             "the plan's acceleration", "warning"),
    )  # fmt: skip


def _ardupilot() -> tuple[Rule, ...]:
    return (
        Rule("GUID_TIMEOUT", _most(STREAM_LOSS_TIME), STREAM_LOSS_TIME,
             f"at most {STREAM_LOSS_TIME:g} s", _STREAM),
        Rule("FS_GCS_ENABLE", _one_of(5), 5, "5 (land)",
             "without the ground station everybody must land"),
        Rule("FS_GCS_TIMEOUT", _one_of(GROUND_LOSS_TIME), GROUND_LOSS_TIME,
             f"{GROUND_LOSS_TIME:g} s", "nobody may decide earlier than the others"),
        Rule("FS_THR_ENABLE", _one_of(0, 3), 3, "0 or 3 (land)", _ALONE),
        Rule("BATT_FS_LOW_ACT", _one_of(0, 1), 0, "0 (warn) or 1 (land)", _ALONE),
        Rule("BATT_FS_CRT_ACT", _one_of(0, 1), 0, "0 (warn) or 1 (land)", _ALONE),
        Rule("FS_EKF_ACTION", _one_of(1, 2, 3), 1, "1 to 3 (land or altitude hold)", _ALONE),
        Rule("FS_DR_ENABLE", _one_of(0, 1), 1, "0 or 1 (land)", _ALONE),
        Rule("FENCE_ACTION", _one_of(0, 2), 0, "0 (report) or 2 (land)", _ALONE,
             unless=("FENCE_ENABLE", 0.0)),
        Rule("DISARM_DELAY", lambda value: value == 0.0 or value >= 10.0, 10.0,
             "0 or at least 10 s", "arming the team takes a few seconds"),
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
        row = Row(system, rule.name, value, rule.should, rule.words, rule.why, severity)
        (good if fine else wrong).append(row)
    return wrong, good
