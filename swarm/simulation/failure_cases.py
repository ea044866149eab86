"""Failure cases: the fault, the required detection and the allowed ends; the table of them.

Failures outside the links (files, processes, sockets) are listed with the tests that cause them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from swarm.errors import InputError, Problem, Refused
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.planning import Plan

Part = Literal["fold", "grab", "release"]
"""The part of the flight in which a fault occurs."""

Group = Literal["one vehicle", "links", "ground station", "world"]
StationFault = Literal["stalled", "killed", "interrupted", "interrupted twice"]
End = Literal["continued", "landed", "released and landed", "landed by failsafe", "completed"]
"""How a flight ends after a fault; "continued" is a flight that is still on its plan."""


@dataclass(frozen=True)
class FailureCase:
    """A fault, and the required behaviour of the team.

    - ``fault``: one of `sitl.faults`, without time and vehicle; with ``whole_team`` it hits all
      vehicles. ``station_fault`` is a fault of the ground station, ``lost_message`` a message that
      is lost. ``duration`` in seconds, 0 for a permanent fault.
    - ``detection_limit``: seconds within which the fault must be detected, None where no detection
      is required. It is detected by an event, or with ``slows_clock`` by a slower mission clock.
      With ``may_be_hidden`` the time counts only while the fault has a measurable effect, or, but
      for slips, while the vehicle is outside its tracking radius.
    - ``allowed_ends``: with ``pilot_lands`` a pilot lands the vehicle along with the team.
    - ``loses_vehicle``: the fault itself takes a vehicle out of the air. ``moves_certified``: it
      moves vehicles or cable beyond the certificate. ``vehicle_drifts``: it does so with one
      vehicle, and with the cable only where it cannot be released.
    - ``allowed_strikes``: number of rotor strikes on cable that may happen; contacts of one vehicle
      that are more than a second apart are several. With ``own_strikes`` those of the failed
      vehicle, which drifts, are not counted. With ``cannot_follow`` the vehicle
      stays where it is and the others with it; one more strike may happen where the team can
      neither land nor release without cable on a rotor. With ``lands_alone`` the failsafes
      of the autopilots land the vehicles where they are; one more strike may happen where the
      plan has no window for landing. With ``cable_falls`` the fault itself lets a strand fall: its
      strikes are not counted where the plan has cable above rotors meanwhile.
    - ``stream_loss``: vehicles fly on without setpoints, so the worst case of the stream loss
      certificate applies: the mission's own clearances.
    - ``needs_cable``: without cable there is no such fault, or none that has to slow the team.
      ``least_vehicles``: so many are compared to detect it.
    - ``explanation``: the reason for exceptions.
    """

    name: str
    group: Group
    allowed_ends: tuple[End, ...]
    fault: Mapping[str, Any] | None = None
    part: Part = "fold"
    detection_limit: float | None = None
    slows_clock: bool = False
    may_be_hidden: bool = False
    whole_team: bool = False
    loses_vehicle: bool = False
    moves_certified: bool = False
    vehicle_drifts: bool = False
    allowed_strikes: int = 0
    own_strikes: bool = False
    cannot_follow: bool = False
    lands_alone: bool = False
    cable_falls: bool = False
    stream_loss: bool = False
    explanation: str = ""
    station_fault: StationFault | None = None
    duration: float = 0.0
    lost_message: str = ""
    pilot_lands: bool = False
    needs_cable: bool = False
    least_vehicles: int = 1


class SystemFailureCase(NamedTuple):
    """A failure of files, processes or sockets, the required behaviour, and its tests."""

    name: str
    expected: str
    tests: tuple[str, ...]


SYSTEM_FAILURE_CASES: tuple[SystemFailureCase, ...] = (
    SystemFailureCase(
        "disk full",
        "reported once; the flight continues, the record keeps the data written before",
        (
            "tests/ground/test_fly.py::"
            "test_a_disk_that_becomes_full_in_flight_damages_the_record_only",
            "tests/ground/test_record.py::test_a_full_disk_damages_the_record_only",
        ),
    ),
    SystemFailureCase(
        "viewer hangs",
        "no setpoint is late; the viewer loses the data that it does not read",
        (
            "tests/ground/test_flight_process.py::test_a_slow_caller_does_not_delay_the_flight",
            "tests/view/test_feeds.py::test_a_stalled_sink_delays_neither_flight_nor_other_sinks",
            "tests/view/test_feeds.py::test_a_killed_sink_delays_neither_flight_nor_other_sinks",
        ),
    ),
    SystemFailureCase(
        "killed in flight and resumed",
        "the record lacks one second at most; the next process finds the team and holds it",
        (
            "tests/ground/test_fly.py::"
            "test_after_sigkill_only_the_last_second_of_the_record_is_missing",
            "tests/flight/test_resuming.py",
            "tests/ground/test_resume.py",
        ),
    ),
    SystemFailureCase(
        "foreign packets on the links",
        "spoofed, replayed and fuzzed packets and floods change no setpoint",
        ("tests/flight/test_security.py", "tests/ground/test_flood.py"),
    ),
)


_CONTINUED: tuple[End, ...] = ("continued", "completed")
_LANDED: tuple[End, ...] = ("landed", "released and landed")
_FALLS = "the vehicle falls; its rotors may strike cable below"
_CANNOT_FOLLOW = (
    "the vehicle no longer follows setpoints, so the team cannot move to a place where all can "
    "land together; where it can neither land nor release as it stands, it lands, and cable may "
    "touch a rotor on the ground"
)
_LANDS_ALONE = (
    "the failsafes of the autopilots land the vehicles where they are; where the plan has no "
    "window for landing, cable may touch a rotor on the ground"
)
_SILENCE = 1.2
"""Seconds: more than the fleet's limits.silence and a packet's time."""


def _gaps() -> Iterator[FailureCase]:
    """Yield gaps of 0.1, 0.5, 2 and 10 s in telemetry, setpoints and both; for one and for all.

    A vehicle without setpoints for half a second may leave offboard mode, as PX4 does; the team
    then holds, and lands after T.
    """
    names = {"down": "telemetry", "up": "setpoint", "both": "two-way"}
    for whole in (False, True):
        for direction, name in names.items():
            for seconds in (0.1, 0.5, 2.0, 10.0):
                loses_setpoints = seconds >= 0.5 and direction != "down"
                lands_alone = loses_setpoints and seconds > 5.0
                ends = list(_CONTINUED)
                if loses_setpoints:
                    ends.append("landed")
                if lands_alone:
                    ends.append("landed by failsafe")
                yield FailureCase(
                    f"{name} gap of {seconds:g} s, {'all' if whole else 'one'}",
                    "links",
                    tuple(ends),
                    {"kind": "link", "loss": 1.0, "direction": direction, "duration": seconds},
                    detection_limit=None if seconds < 1.0 else _SILENCE,
                    whole_team=whole,
                    duration=seconds,
                    stream_loss=direction != "down" and seconds >= STREAM_LOSS_TIME,
                    lands_alone=lands_alone,
                    explanation=_LANDS_ALONE if lands_alone else "",
                )


FAILURE_CASES: tuple[FailureCase, ...] = (
    FailureCase(
        "lags",
        "one vehicle",
        _CONTINUED,
        {"kind": "weak_thrust", "fraction": 0.9},
        detection_limit=2.0,
        needs_cable=True,
        slows_clock=True,
        may_be_hidden=True,
        explanation="a vehicle that keeps its tracking radius flies as certified",
    ),
    FailureCase(
        "weak thrust",
        "one vehicle",
        (*_CONTINUED, "landed"),
        {"kind": "weak_thrust", "fraction": 0.75},
        detection_limit=2.0,
        needs_cable=True,
        slows_clock=True,
    ),
    FailureCase(
        "motor lost",
        "one vehicle",
        _LANDED,
        {"kind": "motor_loss"},
        detection_limit=0.3,
        loses_vehicle=True,
        explanation=_FALLS,
    ),
    FailureCase(
        "battery low",
        "one vehicle",
        ("landed",),
        {"kind": "battery", "charge": 0.18},
        detection_limit=1.0,
    ),
    FailureCase(
        "battery critical",
        "one vehicle",
        ("landed",),
        {"kind": "battery", "charge": 0.09},
        detection_limit=1.0,
    ),
    FailureCase(
        "position lost",
        "one vehicle",
        _LANDED,
        {"kind": "position_loss"},
        detection_limit=1.0,
        moves_certified=True,
        allowed_strikes=1,
        own_strikes=True,
        explanation=(
            "it descends without a position and drifts with the cable through the team; where "
            "cable hangs above a rotor it cannot be released; its own rotors may touch cable"
        ),
    ),
    FailureCase(
        "position degraded",
        "one vehicle",
        _LANDED,
        {"kind": "gps_loss"},
        detection_limit=1.5,
        vehicle_drifts=True,
        allowed_strikes=1,
        own_strikes=True,
        explanation=(
            "it drifts on dead reckoning, possibly towards another vehicle, and moves the cable "
            "where cable hangs above a rotor, so that it cannot be released; its own rotors may "
            "touch cable"
        ),
    ),
    FailureCase(
        "position jumps",
        "one vehicle",
        ("landed",),
        {"kind": "gps_jump", "offset": (3.0, -2.0, 0.5)},
        detection_limit=0.3,
    ),
    FailureCase(
        "origin reset",
        "one vehicle",
        ("landed",),
        {"kind": "origin_reset", "offset": (4.0, 3.0, 1.0)},
        detection_limit=0.3,
    ),
    FailureCase(
        "barometer drifts",
        "one vehicle",
        _LANDED,
        {"kind": "barometer_drift", "rate": 0.1},
        detection_limit=6.0,
        least_vehicles=3,
        allowed_strikes=1,
        explanation=(
            "the height drifts by as much as the error of GPS before GPS shows it: 0.3 m with "
            "these receivers, 1 m with poor ones; it drifts on during the landing where the cable "
            "cannot be released, and a rotor may touch cable"
        ),
    ),
    FailureCase(
        "heading disagrees",
        "one vehicle",
        _LANDED,
        {"kind": "heading", "turn": 0.7},
        detection_limit=0.5,
    ),
    FailureCase(
        "pilot takes over",
        "one vehicle",
        ("landed",),
        {"kind": "pilot"},
        detection_limit=0.5,
        pilot_lands=True,
        cannot_follow=True,
        explanation=_CANNOT_FOLLOW,
    ),
    FailureCase(
        "leaves offboard",
        "one vehicle",
        ("landed",),
        {"kind": "leave_offboard"},
        detection_limit=0.5,
        cannot_follow=True,
        explanation=_CANNOT_FOLLOW,
    ),
    FailureCase(
        "disarms",
        "one vehicle",
        _LANDED,
        {"kind": "disarm"},
        detection_limit=0.3,
        loses_vehicle=True,
        explanation=_FALLS,
    ),
    FailureCase(
        "reboots",
        "one vehicle",
        _LANDED,
        {"kind": "reboot"},
        detection_limit=1.5,
        loses_vehicle=True,
        explanation=_FALLS,
    ),
    FailureCase(
        "reports a false landing",
        "one vehicle",
        _LANDED,
        {"kind": "believes_landed"},
        detection_limit=0.5,
        loses_vehicle=True,
        explanation=_FALLS,
    ),
    FailureCase(
        "gripper fails to grab",
        "one vehicle",
        ("landed",),
        {"kind": "gripper_stuck_open"},
        part="grab",
        detection_limit=8.0,
    ),
    FailureCase(
        "gripper slips",
        "one vehicle",
        ("landed", *_CONTINUED),
        {"kind": "gripper_slip"},
        detection_limit=10.0,
        least_vehicles=3,
        needs_cable=True,
        may_be_hidden=True,
        moves_certified=True,
        cable_falls=True,
        explanation=(
            "the cable between its neighbours becomes one long strand; the slip is detected from "
            "their lean, and where that changes by less than 0.2 N only after the team has moved; "
            "where cable is above a vehicle as it falls, or comes there in its first swing or "
            "before the team stands, it falls on the rotor"
        ),
    ),
    FailureCase(
        "gripper sticks shut at release",
        "one vehicle",
        ("landed",),
        {"kind": "gripper_stuck_shut"},
        part="release",
        detection_limit=3.0,
    ),
    *_gaps(),
    FailureCase(
        "20 % loss",
        "links",
        _CONTINUED,
        {"kind": "link", "loss": 0.2},
        whole_team=True,
    ),
    FailureCase(
        "300 ms latency with jitter",
        "links",
        _CONTINUED,
        {"kind": "link", "latency": 0.3, "jitter": 0.1},
        whole_team=True,
        slows_clock=True,
    ),
    FailureCase(
        "duplicates and reordering",
        "links",
        _CONTINUED,
        {"kind": "link", "duplicate": 0.3, "reorder": 0.3},
        whole_team=True,
    ),
    FailureCase(
        "one ACK lost at the release", "links", _CONTINUED, part="release", lost_message="ack"
    ),
    FailureCase(
        "starved of CPU for 1 s",
        "ground station",
        (*_CONTINUED, "landed"),
        station_fault="stalled",
        duration=1.0,
        slows_clock=True,
        stream_loss=True,
    ),
    FailureCase(
        "interrupted once",
        "ground station",
        ("landed",),
        station_fault="interrupted",
        detection_limit=0.1,
    ),
    FailureCase(
        "interrupted twice",
        "ground station",
        ("landed",),
        station_fault="interrupted twice",
        detection_limit=0.1,
    ),
    FailureCase(
        "killed",
        "ground station",
        ("landed by failsafe",),
        station_fault="killed",
        stream_loss=True,
        lands_alone=True,
        explanation=_LANDS_ALONE,
    ),
    FailureCase(
        "wind beyond w*",
        "world",
        (*_CONTINUED, *_LANDED),
        {"kind": "wind"},
        detection_limit=3.0,
        slows_clock=True,
        moves_certified=True,
        allowed_strikes=2,
        explanation=(
            "a sudden wind of 6 m/s deflects the cable by 50° and pushes vehicles off their path; "
            "the cable may touch a rotor as the wind sets in, and one during the landing; 15 m/s "
            "at most, because emulated vehicles cannot hold their positions from 17 m/s on"
        ),
    ),
    FailureCase(
        "snag",
        "world",
        (*_CONTINUED, *_LANDED),
        {"kind": "snag"},
        needs_cable=True,
        moves_certified=True,
        slows_clock=True,
        allowed_strikes=1,
        explanation=(
            "a snagged strand does not have the shape of the cable model; where it is taken for a "
            "slip, the team lands, and cable that hangs from above may touch a rotor before it "
            "pulls"
        ),
    ),
)


def cases_of(plan: Plan, names: Sequence[str] = ()) -> list[FailureCase]:
    """Return the failure cases that can occur in a plan, whose names contain one of ``names``.

    Raises :class:`InputError` where no name matches, and :class:`Refused` where none of them can
    occur.
    """
    cases = [
        case for case in FAILURE_CASES if not names or any(part in case.name for part in names)
    ]
    if not cases:
        known = ", ".join(case.name for case in FAILURE_CASES)
        raise InputError([Problem("--filter", f"expected a part of one of: {known}")])
    cable = len(plan.layout.lengths) > 0
    cases = [
        case
        for case in cases
        if case.part in _parts(plan)
        and case.least_vehicles <= plan.vehicles
        and (cable or not case.needs_cable)
    ]
    if not cases:
        raise Refused("none of these failures can occur in this mission")
    return cases


def _parts(plan: Plan) -> set[Part]:
    """Return the parts of a flight, of those with failure cases, that a plan has."""
    conditions = {gate.condition for gate in plan.gates}
    parts: set[Part] = {"fold"} if any(phase.name == "fold" for phase in plan.phases) else set()
    if "gripped" in conditions:
        parts.add("grab")
    if "released" in conditions:
        parts.add("release")
    return parts
