"""Failure detection: the observed team against the commanded one, each detector by itself.

In this order: a clock that stands still, and holds that last too long; the ground station itself;
what vehicles report themselves (modes, arming, landing, commands, reboots, origins); silent
vehicles; falls and position jumps; batteries and position estimates; drifting barometers; wrong
headings; large tracking errors in flights that measure them. Slips of the cable are in
:mod:`swarm.flight.grip_slip`.
"""

import math
from statistics import median
from typing import Protocol

import numpy as np
import numpy.typing as npt

from swarm.flight import estimation
from swarm.flight.estimation import Measured
from swarm.flight.failures import Failure, FailureKind, Finding, HoldCause, Latch, Recovery
from swarm.flight.grip_slip import GripSlipDetector
from swarm.flight.observation import Expected, Observation
from swarm.flight.parameters import STREAM_LOSS_TIME
from swarm.flight.router import answer_limit
from swarm.flight.setup import Setup
from swarm.flight.stages import Stage
from swarm.mavlink.vehicle import Vehicle, VehicleEvent
from swarm.mission.fleet import Limits

SLOW_FROM = 0.6
"""Share of the allowed tracking error from which the clock slows; at the full error it stops."""
CALM = 0.5
"""Share of the allowed tracking error within which a vehicle follows undisturbed."""
STOPPED_RATE = 0.02
"""Rate of the clock that counts as none: a minute of flight would last 50 minutes."""
STANDSTILL_TIME = 3.0
"""Seconds for which the clock may stand without a cause that ends by itself."""
STANDSTILL = HoldCause(FailureKind.STANDSTILL)


class StandstillDetector:
    """Detects a clock that a tracking error or a clearance keeps at rest; remembers since when.

    ``enabled`` is false in flights whose clock keeps its rate.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._since = 0.0

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that the clock stands still, or that it no longer has to."""
        if expected.waiting:
            return []
        held = STANDSTILL in expected.holds
        standing = abs(expected.rate) < STOPPED_RATE and not expected.rewinding
        if not (standing or held) or not self._enabled:
            self._since = seen.now
            return []
        worst = seen.largest_error / expected.allowed_error
        off, sample = worst >= SLOW_FROM, expected.monitored
        stopped = off or (sample is not None and sample.pace < STOPPED_RATE)
        if held and not stopped:
            self._since = seen.now
            ended = frozenset({FailureKind.STANDSTILL})
            return [Recovery(ended, "all vehicles follow again", "hold")]
        if held:
            return []
        if expected.holds or not stopped:
            self._since = seen.now
        elif seen.now - self._since > STANDSTILL_TIME:
            return [Failure(FailureKind.STANDSTILL, _cause(seen, expected))]
        return []


class BlockedDetector:
    """Detects that a team outside the plan cannot move on to where it is to land or release."""

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that the cable is caught, or that errors or clearances keep the clock at rest."""
        if expected.blocked <= STANDSTILL_TIME:
            return []
        kind = FailureKind.SNAGGED if _few_are_off(seen, expected) else FailureKind.STANDSTILL
        return [Failure(kind, _cause(seen, expected))]


class HoldTimeoutDetector:
    """Detects a hold that has lasted for T, ``limit`` in seconds; remembers ``since`` when."""

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self.since: float | None = None

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that the hold must end: before a battery decides it."""
        if not expected.holds:
            self.since = None
        elif self.since is None:
            self.since = seen.now
        elif seen.now - self.since > self._limit:
            snagged = STANDSTILL in expected.holds and _few_are_off(seen, expected)
            kind = FailureKind.SNAGGED if snagged else FailureKind.HOLD_TIMEOUT
            causes = "; ".join(expected.holds.values())
            return [Failure(kind, f"on hold for {self._limit:g} s: {causes}")]
        return []


def _cause(seen: Observation, expected: Expected) -> str:
    worst = seen.largest_error / expected.allowed_error
    off = worst >= SLOW_FROM
    return _large_errors(seen, expected, worst) if off else _small_clearances(expected)


def _large_errors(seen: Observation, expected: Expected, worst: float) -> str:
    allowed = expected.allowed_error
    off = [
        name
        for name, error in zip(seen.names, seen.error, strict=True)
        if error > SLOW_FROM * allowed
    ]
    return f"{', '.join(off)} cannot follow (errors up to {worst * allowed:.2f} m)"


def _small_clearances(expected: Expected) -> str:
    if expected.monitored is None:
        return "no clearance remains"
    seen = expected.monitored.clearances
    cable = "no slack" if math.isnan(seen.cable) else f"strands {seen.cable:.2f} m apart"
    return (
        f"no clearance remains ({seen.kind}: margin {seen.margin:.2f} m; {cable}, vehicles "
        f"{seen.vehicle:.2f} m apart, chords up to {seen.chord:.0%} of the cable length)"
    )


def _few_are_off(seen: Observation, expected: Expected) -> bool:
    """Return whether one or two vehicles stop the clock and all others follow: wind moves all.

    By then autopilots lean against the caught strand, and have brought the vehicle nearer.
    """
    off = np.nan_to_num(seen.error, nan=0.0) / expected.allowed_error
    far, calm = off >= SLOW_FROM, off < CALM
    return bool(1 <= far.sum() <= 2 and (far | calm).all())


STALLED = HoldCause(FailureKind.STATION_STALLED)
AFTER_STALL = 1.0
"""Seconds of setpoints after which vehicles that still get them have answered: mode and position
come more often, and a vehicle that has left offboard mode has reported it."""


class StationDetector:
    """Detects that the ground station did not run, and that the team follows again after that."""

    def __init__(self) -> None:
        self._since = 0.0

    def stalled(self, now: float, elapsed: float) -> list[Finding]:
        """Return a gap of ``elapsed`` seconds in the setpoints after which all vehicles stop.

        It precedes what the vehicles report: they may have stopped for it.
        """
        if elapsed <= STREAM_LOSS_TIME:
            return []
        self._since = now
        words = f"the ground station stood still for {elapsed:.1f} s and sent no setpoint"
        return [Failure(FailureKind.STATION_STALLED, words)]

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return that all vehicles get setpoints, and follow them again."""
        if STALLED not in expected.holds or seen.now - self._since < AFTER_STALL:
            return []
        follow = expected.streaming & (seen.error <= SLOW_FROM * expected.allowed_error)
        if not follow.all():
            return []
        ended = frozenset({FailureKind.STATION_STALLED})
        return [Recovery(ended, "all vehicles follow the setpoints again", "hold")]


HIGH = 1.0
"""Metres above its pad from which a vehicle is surely in the air."""
_LANDING_MODES = frozenset({"land", "precision land"})
_RETURN_MODES = frozenset({"return", "smart return", "auto return"})


class ReportDetector:
    """Judges the events that vehicles report; positions are those of the tick before.

    What is reported of a ``compass`` counts where headings come from one: motion capture has its
    own, and halls disturb compasses.
    """

    def __init__(self, *, compass: bool) -> None:
        self._compass = compass
        self._left: dict[int, FailureKind] = {}

    def detect(
        self,
        seen: Observation,
        expected: Expected,
        k: int,
        vehicle: Vehicle,
        event: VehicleEvent,
        now: float,
    ) -> list[Finding]:
        """Return the failure that an event of a vehicle reports, if it is one."""
        name = seen.names[k]
        flying = bool(expected.armed[k]) and not expected.may_land[k]
        high = float(seen.position[k, 2]) - float(expected.start_height[k]) > HIGH
        failure: Failure | None = None
        match event.kind:
            case "failed" if k not in expected.fallen and not event.subject.startswith("interval"):
                failure = Failure(FailureKind.COMMAND_FAILED, f"{name}: {event.message}", k)
            case "disarmed" if flying and (expected.streaming[k] or high):
                failure = Failure(FailureKind.DISARMED, f"{name} disarmed in flight", k)
            case "landed" if flying and not expected.descending and high:
                words = f"{name} reports that it has landed, in the air"
                failure = Failure(FailureKind.FALSE_LANDING, words, k)
            case "mode" if flying and k not in expected.rejoining | expected.fallen:
                if not vehicle.in_mode("offboard"):
                    failure = _left_offboard(name, k, vehicle, event, now)
                    # a PX4 that had lost its setpoints takes the last ones, and loses them again
                    known = not expected.streaming[k] and self._left.get(k) is failure.kind
                    self._left[k] = failure.kind
                    failure = None if known else failure
            case "rebooted":
                failure = Failure(FailureKind.REBOOTED, f"{name} {event.message}", k)
            case "text warning" | "text error" if (
                self._compass and flying and k not in expected.fallen
            ):
                if _tells_of_heading(event.message):
                    words = f"{name}: {event.message}"
                    failure = Failure(FailureKind.HEADING_DISAGREES, words, k)
            case "origin" if k not in expected.fallen:
                failure = Failure(FailureKind.ORIGIN_MOVED, f"{name}: {event.message}", k)
        return [] if failure is None else [failure]


_HEADING_TEXTS = "emergency yaw reset", "compass needs calibration", "heading not reliable"
"""Words of both firmwares' messages in flight: ArduPilot 4.6 and PX4 1.16 after the velocity by
satellites contradicted the compass (ArduPilot resets the heading, PX4 asks to land); PX4 on a
heading by satellites."""


def _tells_of_heading(text: str) -> bool:
    return any(words in text.lower() for words in _HEADING_TEXTS)


def _left_offboard(name: str, k: int, vehicle: Vehicle, event: VehicleEvent, now: float) -> Failure:
    """Return how a vehicle has left offboard mode: by its own decision, or a pilot's."""
    texts = vehicle.recent_warnings(now)
    words = f"{name} left offboard mode uncommanded: {event.message}"
    words += f" ({texts})" if texts else ""
    if vehicle.in_manual_mode:
        kind = FailureKind.PILOT
    elif vehicle.mode in _LANDING_MODES:
        kind = FailureKind.LANDING_ALONE
    elif vehicle.mode in _RETURN_MODES:
        kind = FailureKind.RETURNING
    else:
        kind = FailureKind.LEFT_OFFBOARD
    return Failure(kind, words, k)


MODE_VALID = 1.5
"""Seconds after its report for which a mode is taken for the vehicle's."""
FALLEN_SILENCE = 0.5
"""Seconds of silence after which a vehicle whose neighbour is pulled down has fallen."""
PULLED_DOWN = 0.3
"""Metres by which that neighbour is below its setpoint."""
PULLED_ASIDE = math.radians(30.0)
"""Or its tilt, which the pull turns first: six real vehicles beside a stopped one went from 20 to
40° to 60 to 130° within 0.1 s. Against a wind of 8 m/s a vehicle leans by 22°."""

_ENDED = frozenset({FailureKind.SILENT, FailureKind.LOST, FailureKind.ALL_LOST})


class LinkDetector:
    """Detects vehicles that fall silent, and reports those that are received again."""

    def __init__(self, limits: Limits, reported: Latch) -> None:
        self._limits, self._reported = limits, reported
        self._silent: set[int] = set()
        self._shortest = min(FALLEN_SILENCE, limits.silence, limits.lost or limits.silence)
        self._unanswered = answer_limit(limits)

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures and recoveries of the links at this tick."""
        heard = seen.now - float(seen.received_at.min()) <= self._shortest
        answered = seen.now - float(seen.asked_at.min()) <= self._unanswered
        if not self._silent and heard and answered:
            return []
        limits, findings = self._limits, list[Finding]()
        lost = [
            k
            for k in range(len(seen.names))
            if seen.silent_for(k) > (limits.lost or limits.silence)
        ]
        all_lost = len(lost) == len(seen.names)
        for k, name in enumerate(seen.names):
            findings += self._silence(seen, k)
            if k in lost and not all_lost:
                words = f"no packets for {limits.lost:g} s: {name}"
                findings += self._reported.once(FailureKind.LOST, k, words)
            if seen.silent_for(k) > FALLEN_SILENCE and neighbour_pulled_down(seen, expected, k):
                findings += fallen_silent(seen, self._reported, k)
        if all_lost and self._reported.first(FailureKind.ALL_LOST, 0):
            words = f"no packets of any vehicle for {limits.lost:g} s"
            findings.append(Failure(FailureKind.ALL_LOST, words))
        return findings

    def _silence(self, seen: Observation, k: int) -> list[Finding]:
        """Return that a vehicle falls silent or does not answer, or that it is received again."""
        name, words = seen.names[k], ""
        if seen.silent_for(k) > self._limits.silence:
            words = f"{name} has been silent for {self._limits.silence:g} s"
        elif seen.unanswered_for(k) > self._unanswered:
            words = f"{name} has not answered for {self._limits.silence:g} s: it may not receive"
        silent = bool(words)
        if silent and k not in self._silent:
            self._silent.add(k)
            return [Failure(FailureKind.SILENT, words, k)]
        # after a gap it may land by itself: its mode must be known first
        if silent or k not in self._silent or not mode_valid(seen, k):
            return []
        self._silent.discard(k)
        self._reported.forget(FailureKind.LOST, k)
        self._reported.forget(FailureKind.ALL_LOST, 0)
        return [Recovery(_ENDED, f"{name} is received again", "link", k)]


def mode_valid(seen: Observation, k: int) -> bool:
    """Return whether a vehicle has reported its mode recently."""
    return seen.now - float(seen.mode_at[k]) <= MODE_VALID


def neighbours(seen: Observation, k: int) -> list[int]:
    """Return the vehicles next to a vehicle along the cable."""
    return [j for j in (k - 1, k + 1) if 0 <= j < len(seen.names)]


def neighbour_pulled_down(seen: Observation, expected: Expected, k: int) -> bool:
    """Return whether a neighbour along the cable is well below its setpoint, or tilted far."""
    if expected.cable != "aloft" or not expected.armed[k]:
        return False
    below = expected.setpoint[:, 2] - seen.position[:, 2]
    tilt = np.abs(seen.attitude[:, :2]).max(axis=1)
    return any(
        (below[j] > PULLED_DOWN or tilt[j] > PULLED_ASIDE)
        and expected.streaming[j]
        and seen.now - seen.position_at[j] <= FALLEN_SILENCE
        for j in neighbours(seen, k)
    )


def fallen_silent(seen: Observation, reported: Latch, k: int) -> list[Finding]:
    """Return, once, that a silent vehicle has fallen."""
    words = f"{seen.names[k]} is silent and a neighbour is pulled down: it has fallen"
    return reported.once(FailureKind.FALLEN_SILENT, k, words)


Floats = npt.NDArray[np.float64]

SINKING = 1.0
"""m/s by which a vehicle may descend faster than commanded."""
FALLING, FALLING_SINKING = 5.0, 0.4
"""m/s² downwards, between two reports, that no vehicle with thrust shows: half of a free fall; and
m/s of sinking that it has reached after 0.08 s, so that noise between two reports is none."""
TURNED_OVER = math.radians(60.0)
"""Roll or pitch; PX4's own failure detector uses the same angle (FD_FAIL_R)."""
RECOVERY = 1.5
"""Seconds within which a vehicle that a lost neighbour or a caught strand pulled must recover after
its release. A PX4 that was tilted to 50° did so within 0.5 s; grippers open within as much again,
and its own link may be late by 0.5 s."""
UNHEARD = 0.2
"""Seconds of silence after which a neighbour may be the vehicle that falls: five reports and more
are missing. Whether it is received again is known after FALLEN_SILENCE."""
JUMP = 0.5
"""Metres between a reported position and the one that the report before predicts."""
LONGEST_STEP = 0.5
"""Seconds between reports up to which a jump can be distinguished from flight."""
_CALM = LONGEST_STEP, SINKING, FALLING_SINKING, 0.5 * JUMP, TURNED_OVER
"""Motion within these limits is no failure (`estimation.new_reports`). Beyond them it is examined,
and may still be none."""


class MotionDetector:
    """Detects vehicles that fall, and positions that jump; remembers each vehicle's last report.

    A vehicle that a lost neighbour pulls by the cable, or that lets go of cable that may have held
    it up, is judged by whether it recovers. Without ``cable`` none is pulled.
    """

    def __init__(self, n: int, reported: Latch, *, cable: bool) -> None:
        self._reported, self._carries_cable = reported, cable
        self._last = Measured.of(n)
        self._step = np.zeros(n)
        self._disturbed: dict[int, tuple[float, bool, bool]] = {}

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures of motion at this tick."""
        now, last = seen.measured, self._last
        new, calm = estimation.new_reports(
            seen.table, seen.rows, (now, last), (expected.velocity, expected.streaming), _CALM,
            self._step,
        )  # fmt: skip
        if not new:
            return []
        findings: list[Finding] = []
        if calm:
            self._disturbed.clear()
        else:
            for k in range(len(seen.names)):
                if expected.armed[k] and not expected.may_land[k] and now.at[k] > last.at[k]:
                    findings += self._examine(seen, expected, k)
        estimation.keep_reports(now, last, self._step)
        return findings

    def follow_frame(self, k: int, jump: Floats) -> None:
        """Follow a frame that moved: the next report is compared in it."""
        self._last.reported[k] -= jump

    def _examine(self, seen: Observation, expected: Expected, k: int) -> list[Finding]:
        last = self._last
        step = float(self._step[k])
        before, up = last.velocity[k], float(seen.velocity[k, 2])
        commanded = min(0.0, float(expected.velocity[k, 2])) if expected.streaming[k] else -SINKING
        if not mode_valid(seen, k):
            commanded = -math.inf
        sinking = commanded - up
        falls = step > 0.04 and (before[2] - up) / step > FALLING and sinking > FALLING_SINKING
        tilt = max(abs(float(seen.attitude[k, 0])), abs(float(seen.attitude[k, 1])))
        if sinking > SINKING or falls or tilt > TURNED_OVER:
            return self._fallen(seen, expected, k, tilt, falls=falls)
        self._disturbed.pop(k, None)
        if step > LONGEST_STEP or k in expected.fallen:
            return []
        predicted = last.reported[k] + 0.5 * step * (before + seen.velocity[k])
        jump = seen.measured.reported[k] - predicted
        size = float(np.linalg.norm(jump))
        if size <= JUMP:
            return []
        words = f"{seen.names[k]}'s position jumped by {size:.1f} m: its frame moved"
        known = not self._reported.first(FailureKind.POSITION_JUMP, k)
        return [Failure(FailureKind.POSITION_JUMP, words, k, jump, known)]

    def _fallen(
        self, seen: Observation, expected: Expected, k: int, tilt: float, *, falls: bool
    ) -> list[Finding]:
        """Return which vehicle has fallen: this one, or a silent neighbour that pulls it.

        A vehicle that sinks without other signs of a fall may do so in a mode of its own choice,
        which must be reported first.
        """
        since, cabled = self._note(seen, k)
        if (cabled or k in expected.opening) and expected.cable in {"lifting", "aloft"}:
            near = neighbours(seen, k)
            silent = [j for j in near if seen.silent_for(j) > UNHEARD and j not in expected.fallen]
            for j in silent:
                if seen.silent_for(j) > FALLEN_SILENCE and (
                    findings := fallen_silent(seen, self._reported, j)
                ):
                    return findings
            earlier = [j for j in near if j in self._disturbed and self._disturbed[j][0] < since]
            lost = silent or earlier or not expected.fallen.isdisjoint(near)
            pulled = lost or k in expected.opening
            if pulled and seen.now - since <= RECOVERY:
                return []
        turned_over = tilt > TURNED_OVER
        if not (falls or turned_over) and seen.mode_at[k] <= since:
            return []
        sinking = f"descending at {-float(seen.velocity[k, 2]):.1f} m/s"
        what = "falls" if expected.streaming[k] or falls or turned_over else "leaves the team"
        how = "turned over" if turned_over else sinking
        return self._reported.once(FailureKind.FALLING, k, f"{seen.names[k]} {what}: {how}")

    def _note(self, seen: Observation, k: int) -> tuple[float, bool]:
        """Return since when a vehicle moves as if it fell, and whether it held the cable then.

        The time begins anew when it lets the cable go.
        """
        held = bool(seen.gripped[k])
        since, before, cabled = self._disturbed.get(k, (seen.now, held, held))
        since = seen.now if before and not held else since
        self._disturbed[k] = since, held, cabled
        return since, cabled and self._carries_cable


BATTERY_LOW, BATTERY_CRITICAL = 0.2, 0.1
"""Shares of charge; above those at which autopilots act alone, so that the team decides."""


class HealthDetector:
    """Detects low batteries, lost positions and unhealthy compasses.

    ``gps`` says whether vehicles need a GPS fix, ``compass`` whether headings come from one.
    """

    def __init__(self, reported: Latch, *, gps: bool, compass: bool) -> None:
        self._reported, self._gps, self._compass = reported, gps, compass

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures of batteries, positions and compasses at this tick."""
        unhealthy = ~(seen.position_healthy & seen.compass_healthy)
        suspect = (seen.battery <= BATTERY_LOW) | unhealthy | seen.poor_fix
        findings: list[Finding] = []
        for k in np.flatnonzero(suspect & expected.armed & ~expected.may_land).tolist():
            battery, name, once = float(seen.battery[k]), seen.names[k], self._reported.once
            words = f"{name} has a battery charge of {battery:.0%}"
            critical = battery <= BATTERY_CRITICAL and once(FailureKind.BATTERY_CRITICAL, k, words)
            if critical:
                findings += critical
            elif battery <= BATTERY_LOW:
                findings += once(FailureKind.BATTERY_LOW, k, words)
            if not seen.position_healthy[k]:
                findings += once(FailureKind.POSITION_LOST, k, f"{name} has no position estimate")
            if seen.poor_fix[k] and self._gps:
                findings += once(FailureKind.FIX_LOST, k, f"{name} has lost its GPS fix")
            if self._compass and not (seen.compass_healthy[k] or k in expected.fallen):
                words = f"{name}'s compass is unhealthy"
                findings += once(FailureKind.HEADING_DISAGREES, k, words)
        return findings


HEIGHT_DRIFT = (0.3, 1.0)
"""Metres by which one vehicle's height may drift against its GPS compared with the others': with
receivers that report a good accuracy while the cable is aloft, and otherwise. A receiver never
permits less than its own accuracy."""
LARGEST_STEP = 0.4
"""Metres by which a height is corrected at once, so that the team need not follow a step."""
_ACCURACIES = 5.0
"""Multiple of the receivers' stated vertical accuracy that a drift must exceed."""
_INTERVAL = 1.0
"""Seconds between comparisons: heights drift over minutes."""


class HeightDetector:
    """Detects heights that drift; remembers the differences with which the comparison began.

    ``reference`` (n,) in metres; it begins anew when the cable is aloft: the gate on the levelled
    line has judged the differences before that. A drift that is reported counts as a jump of the
    reported height, and becomes part of the reference: it may go on during a landing of half a
    minute.
    """

    def __init__(self, n: int, reported: Latch) -> None:
        self._reported = reported
        self.reference: Floats = np.full(n, np.nan)
        self._next, self._aloft = 0.0, False

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the vehicles whose heights have drifted, once a second."""
        if seen.now < self._next:
            return []
        self._next = seen.now + _INTERVAL
        drift = self._drift(seen, expected)
        if np.count_nonzero(np.isnan(drift)) or len(drift) < 3:
            return []
        middle = median(drift.tolist())
        accuracies = seen.vertical_accuracy.tolist()
        stated = [accuracy for accuracy in accuracies if not math.isnan(accuracy)]
        accuracies = [math.inf if math.isnan(accuracy) else accuracy for accuracy in accuracies]
        least, most = HEIGHT_DRIFT
        least = least if self._aloft else most
        most, usual = max(most, *stated) if stated else most, median(accuracies)
        findings: list[Finding] = []
        for k, by in enumerate(drift.tolist()):
            off = by - middle
            allowed = min(max(_ACCURACIES * max(accuracies[k], usual), least), most)
            # an ArduCopter that has landed and disarmed sets its height anew; a PX4 on the ground
            # drifted by 1.2 m before it had detected that: the team can only land, and does
            flies = expected.armed[k] and seen.armed[k] and not expected.may_land[k]
            if flies and abs(off) > allowed:
                step = math.copysign(min(abs(off), LARGEST_STEP), off)
                words = f"{seen.names[k]}'s height has drifted by {off:+.1f} m"
                jump = np.array([0.0, 0.0, -step])
                known = not self._reported.first(FailureKind.HEIGHT_DRIFT, k)
                findings.append(Failure(FailureKind.HEIGHT_DRIFT, words, k, jump, known))
        return findings

    def follow_frame(self, k: int, jump: Floats, kind: FailureKind) -> None:
        """Follow a frame that moved: a drift becomes part of the reference, and after a jump of the
        position, which its satellite receiver may share, the vehicle is compared anew."""
        drifted = kind is FailureKind.HEIGHT_DRIFT
        self.reference[k] = self.reference[k] - jump[2] if drifted else np.nan

    def _drift(self, seen: Observation, expected: Expected) -> Floats:
        begun = expected.cable == "aloft" and not expected.waiting and not expected.holds
        if begun and not self._aloft:
            self.reference[:], self._aloft = np.nan, True
        fresh = np.isnan(self.reference)
        self.reference[fresh] = seen.height_difference[fresh]
        return seen.height_difference - self.reference


HEADING_OFF = 0.35
"""Radians by which a heading must be off what it is to hold: 20°. That of recorded PX4 was off by
15° at most (docs/results/flights.md)."""
_HEADING_SAMPLES = 2
"""Successive attitudes that must be off: one alone lands no team. The autopilot turns back at once
what it takes for its heading: of 40° within 0.25 s to half, with a gain of 2.8 1/s (PX4's
MC_YAW_P). At 10 Hz two attitudes show that."""
_UPRIGHT = 0.3
"""Radians of tilt up to which a heading is compared: beyond, a vehicle may turn over."""


class HeadingDetector:
    """Detects headings that leave the ones held since the flight began; counts samples.

    A pilot may turn a vehicle that is outside the team: from its return on, it is compared as soon
    as its heading has come within the limit.
    """

    def __init__(self, n: int, reported: Latch) -> None:
        self._reported = reported
        self._held: Floats = np.full(n, np.nan)
        self._compared = np.full(n, False)
        self._sampled, self._off = np.full(n, -1.0), np.zeros(n)

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the vehicles whose headings are wrong."""
        heading = seen.attitude[:, 2]
        unknown = np.isnan(self._held)
        self._held[unknown] = heading[unknown]
        turned = (heading - self._held + math.pi) % (2.0 * math.pi) - math.pi
        flies = expected.armed & expected.streaming & ~expected.may_land
        flies[list(expected.rejoining)] = False
        self._compared = flies & (self._compared | (np.abs(turned) <= HEADING_OFF))
        upright = np.abs(seen.attitude[:, :2]).max(axis=1) < _UPRIGHT
        off = self._compared & upright & (np.abs(turned) > HEADING_OFF)
        fresh = seen.attitude_ms != self._sampled
        self._sampled = seen.attitude_ms.copy()
        self._off = np.where(off, self._off + fresh, 0.0)
        findings: list[Finding] = []
        for k in np.flatnonzero(self._off >= _HEADING_SAMPLES).tolist():
            degrees = math.degrees(turned[k])
            words = f"{seen.names[k]}'s heading is {degrees:+.0f}° off what it is to hold"
            if k not in expected.fallen:
                findings += self._reported.once(FailureKind.HEADING_DISAGREES, k, words)
        return findings


class TrackingDetector:
    """Detects a vehicle too far from its setpoint, or too near to another one.

    Too far is the flight's ``limit``, too near the mission's ``clearance`` between vehicles, level.
    The plan's distances do not answer this: errors here may be larger than it allows for.
    """

    def __init__(self, limit: float | None, clearance: float) -> None:
        self._limit, self._clearance = limit, clearance

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the largest error or the nearest pair beyond the limits, if there is one."""
        if self._limit is None or expected.may_land.all():
            return []
        return self._errors(seen, expected, self._limit) or self._distances(seen)

    def _errors(self, seen: Observation, expected: Expected, limit: float) -> list[Finding]:
        error = np.where(expected.streaming & np.isfinite(seen.error), seen.error, 0.0)
        worst = int(np.argmax(error))
        if error[worst] <= limit:
            return []
        words = f"{seen.names[worst]} is {error[worst]:.2f} m from its setpoint, "
        words += f"more than the limit of {limit:g} m"
        return [Failure(FailureKind.TRACKING_ERROR, words, worst)]

    def _distances(self, seen: Observation) -> list[Finding]:
        first, second = np.triu_indices(len(seen.names), 1)
        level = seen.position[:, :2]
        apart = np.linalg.norm(level[first] - level[second], axis=1)
        near = np.flatnonzero(apart < self._clearance)
        if not len(near):
            return []
        pair = near[np.argmin(apart[near])]
        nearer, farther = int(first[pair]), int(second[pair])
        words = f"{seen.names[nearer]} and {seen.names[farther]} are {apart[pair]:.2f} m apart, "
        words += f"less than the required {self._clearance:g} m"
        return [Failure(FailureKind.TRACKING_ERROR, words, nearer)]


IN_FLIGHT = frozenset({Stage.EXECUTE, Stage.CONTINGENCY})
ON_PLAN = frozenset({Stage.EXECUTE})
OFF_PLAN = frozenset({Stage.CONTINGENCY})


class Detector(Protocol):
    """Compares an observation with the commanded state; has its own memory."""

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures and recoveries of this tick."""
        ...


class Detectors:
    """All detectors of a flight; ``each_tick`` are those that run at every tick, in their order,
    each with the stages in which it detects."""

    def __init__(self, setup: Setup) -> None:
        plan, fleet, options = setup.plan, setup.fleet, setup.options
        reported, n = Latch(), plan.vehicles
        carried = setup.carries_cable and not options.open_loop
        paced = not options.open_loop and options.error_limit is None
        compass = fleet.frame != "shared"
        self.reports = ReportDetector(compass=compass)
        self.station = StationDetector()
        self.motion = MotionDetector(n, reported, cable=setup.carries_cable)
        self.heights = HeightDetector(n, reported)
        self.grip_slip = GripSlipDetector(plan, reported, enabled=carried)
        self.hold_timeout = HoldTimeoutDetector(fleet.limits.hold)
        self.each_tick: tuple[tuple[frozenset[Stage], Detector], ...] = (
            (IN_FLIGHT, LinkDetector(fleet.limits, reported)),
            (IN_FLIGHT, self.motion),
            (IN_FLIGHT, HealthDetector(reported, gps=fleet.frame == "gps", compass=compass)),
            (IN_FLIGHT, self.heights),
            (ON_PLAN, self.station),
            (ON_PLAN, self.grip_slip),
            (IN_FLIGHT, HeadingDetector(n, reported)),
            (ON_PLAN, TrackingDetector(options.error_limit, plan.mission.clearance.vehicle)),
            (ON_PLAN, self.hold_timeout),
            (ON_PLAN, StandstillDetector(enabled=paced)),
            (OFF_PLAN, BlockedDetector()),
        )

    def follow_frame(self, k: int, jump: Floats, kind: FailureKind) -> None:
        """Compare in a frame that moved by (3,) metres: with its position, or by a drift."""
        self.motion.follow_frame(k, jump)
        self.heights.follow_frame(k, jump, kind)
