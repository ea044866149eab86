"""Detectors by themselves: an observation and the commanded state in, failures out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from swarm.flight import execute
from swarm.flight.detect import (
    LARGEST_STEP,
    HealthDetector,
    HeightDetector,
    HoldTimeoutDetector,
    LinkDetector,
    MotionDetector,
    ReportDetector,
    StandstillDetector,
    TrackingDetector,
)
from swarm.flight.estimation import Measured
from swarm.flight.failures import OPERATOR, Failure, FailureKind, Latch, Recovery
from swarm.flight.observation import Expected, Observation
from swarm.flight.router import answer_limit, timesync_interval
from swarm.flight.stages import Stage
from swarm.mavlink.telemetry_table import WIDTH
from swarm.mavlink.vehicle import VehicleEvent
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.stepped_simulation import branch, lasting
from tests.network import Network, small_plan

PLACES = np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 5.0], [6.0, 0.0, 5.0]])
LIMITS = emulated_fleet(3).limits


def seen(now=10.0, at=None, position=PLACES, velocity=None, boot=None, **fields) -> Observation:
    """Three vehicles that hover in good health at 5 m, 3 m apart."""
    places = np.zeros((3, 3, 3))
    places[0] = places[2] = position
    places[1] = 0.0 if velocity is None else velocity
    reported_at = np.full(3, now if at is None else at)
    numbers = np.array([reported_at, np.zeros(3), reported_at if boot is None else boot])
    table = np.zeros((3, WIDTH))
    values = {
        "received_at": now, "asked_at": np.inf, "position_at": now, "mode_at": now, "attitude": 0.0,
        "battery": 0.9, "position_healthy": True, "compass_healthy": True, "fix_type": 3,
        "height_difference": 0.0, "vertical_accuracy": 0.1, "gripped": True, "armed": True,
    }  # fmt: skip
    for name, value in (values | fields).items():
        table[:, getattr(Observation, name).columns] = value
    names = ("vehicle 1", "vehicle 2", "vehicle 3")
    return Observation.of(now, names, table, np.arange(3), Measured(places, numbers))


def expected(**fields) -> Expected:
    values = {
        "setpoint": PLACES, "velocity": np.zeros((3, 3)), "streaming": np.full(3, True),
        "armed": np.full(3, True), "may_land": np.full(3, False), "fallen": frozenset(),
        "rejoining": frozenset(), "opening": frozenset(), "start_height": np.zeros(3), "cable": "aloft",
        "descending": False, "waiting": False, "holds": {}, "rate": 1.0, "rewinding": False,
        "allowed_error": 0.1, "monitored": None, "blocked": 0.0,
    }  # fmt: skip
    return Expected(**(values | fields))


def kinds(found) -> list[FailureKind]:
    return [one.kind for one in found if isinstance(one, Failure)]


def test_a_calm_team_shows_no_failure():
    detectors = (
        LinkDetector(LIMITS, Latch()), MotionDetector(3, Latch(), cable=True), HealthDetector(Latch(), gps=True, compass=True),
        TrackingDetector(1.0, 1.0), HoldTimeoutDetector(10.0), StandstillDetector(enabled=True),
    )  # fmt: skip
    for now in (10.0, 10.1, 10.2):
        for detector in detectors:
            assert detector.detect(seen(now), expected()) == []


def test_a_vehicle_is_silent_once_and_is_received_again_with_its_mode():
    links = LinkDetector(LIMITS, Latch())
    silent = np.array([10.0, 10.0 - LIMITS.silence - 0.1, 10.0])
    assert kinds(links.detect(seen(received_at=silent), expected())) == [FailureKind.SILENT]
    assert links.detect(seen(received_at=silent), expected()) == []
    unknown = seen(mode_at=np.array([10.0, 5.0, 10.0]))
    assert links.detect(unknown, expected()) == []
    (recovery,) = links.detect(seen(), expected())
    assert isinstance(recovery, Recovery)
    assert FailureKind.SILENT in recovery.kinds
    assert recovery.vehicle == 1


def test_a_vehicle_that_does_not_answer_is_silent_until_it_does():
    links = LinkDetector(LIMITS, Latch())
    late = answer_limit(LIMITS)
    assert late + timesync_interval(LIMITS) == pytest.approx(LIMITS.silence)
    asked = np.array([np.inf, 10.0 - late + 0.01, np.inf])
    assert links.detect(seen(asked_at=asked), expected()) == []
    (failure,) = links.detect(seen(asked_at=asked - 0.02), expected())
    assert (failure.kind, failure.vehicle) == (FailureKind.SILENT, 1)
    assert failure.message == "vehicle 2 has not answered for 0.7 s: it may not receive"
    assert links.detect(seen(asked_at=asked - 1.0), expected()) == []
    unheard = np.array([10.0, 9.4, 10.0])
    assert (
        LinkDetector(LIMITS, Latch()).detect(
            seen(asked_at=np.array([np.inf, 9.41, np.inf]), received_at=unheard), expected()
        )
        == []
    )
    (recovery,) = links.detect(seen(), expected())
    assert (recovery.kinds >= {FailureKind.SILENT}, recovery.vehicle) == (True, 1)


def test_a_jump_is_measured_and_its_report_does_not_count_twice():
    motion = MotionDetector(3, Latch(), cable=True)
    motion.detect(seen(10.0), expected())
    jumped = PLACES + np.array([[0, 0, 0], [0, 2.0, 0], [0, 0, 0]])
    (failure,) = motion.detect(seen(10.1, position=jumped), expected())
    assert failure.kind is FailureKind.POSITION_JUMP
    assert failure.vehicle == 1
    assert failure.jump == pytest.approx([0.0, 2.0, 0.0])
    motion.follow_frame(1, failure.jump)
    # the frame follows the jump: the next report is where the one before was
    assert motion.detect(seen(10.2), expected()) == []


def test_the_frame_follows_every_jump_of_a_vehicle_and_the_first_is_reported():
    """The estimator of a crashed PX4 moved by 12 m, eleven times in 13 s."""
    motion, place = MotionDetector(3, Latch(), cable=True), PLACES.copy()
    motion.detect(seen(10.0), expected())
    found = []
    for k in range(1, 5):
        place[1, 0] = PLACES[1, 0] + 2.0
        found += motion.detect(seen(10.0 + 0.1 * k, position=place), expected())
        assert found[-1].jump == pytest.approx([2.0, 0.0, 0.0])
        motion.follow_frame(1, found[-1].jump)
        motion.detect(seen(10.05 + 0.1 * k), expected())
    assert [failure.known for failure in found] == [False, True, True, True]


def test_a_corrected_height_is_no_jump_of_the_position():
    """Also where the report beside it errs: each is within 0.5 m of where it was, both are not."""
    motion = MotionDetector(3, Latch(), cable=True)
    motion.detect(seen(10.0), expected())
    step = np.array([0.0, 0.0, -LARGEST_STEP])
    motion.follow_frame(1, step)
    corrected = PLACES + np.array([0.0, 0.0, 0.15])
    corrected[1] -= step
    assert motion.detect(seen(10.1, position=corrected), expected()) == []


def test_a_ground_station_that_was_stalled_sees_no_jump():
    # at 2 m/s: it reads nothing for 1.2 s, then a report of 0.3 s after the last one, then a new one
    motion = MotionDetector(3, Latch(), cable=True)
    velocity = np.tile([2.0, 0.0, 0.0], (3, 1))
    moving = expected(velocity=velocity)

    def report(now, since):
        place = PLACES + since * velocity
        return seen(now, position=place, velocity=velocity, boot=np.full(3, 70.0 + since))

    for now, since in ((10.0, 0.0), (11.2, 0.3), (11.22, 1.2), (11.3, 1.3)):
        assert motion.detect(report(now, since), moving) == []
    jumped = report(11.4, 1.4)
    jumped.measured.reported[1] += [0.0, 2.0, 0.0]
    assert kinds(motion.detect(jumped, moving)) == [FailureKind.POSITION_JUMP]


def test_the_neighbour_that_a_silent_vehicle_pulls_down_has_not_fallen():
    motion = MotionDetector(3, Latch(), cable=True)
    motion.detect(seen(10.0), expected())
    down = np.array([[0.0, 0.0, -2.0], [0, 0, 0], [0, 0, 0]])
    heard = np.array([10.1, 9.0, 10.1])
    (failure,) = motion.detect(seen(10.1, velocity=down, received_at=heard), expected())
    assert (failure.kind, failure.vehicle) == (FailureKind.FALLEN_SILENT, 1)


DOWN = np.array([[0.0, 0.0, -2.0], [0, 0, 0], [0, 0, 0]])
OVER = np.array([[1.2, 0.0, 0.0], [0, 0, 0], [0, 0, 0]])


def flown(motion, moments, **fields) -> list[tuple[float, FailureKind, int]]:
    """Failures of motion at (time, velocity, attitude, when vehicle 2 was received, grippers)."""
    found = []
    for now, velocity, attitude, heard, gripped in moments:
        one = seen(
            now, velocity=velocity, attitude=attitude, received_at=np.array([now, heard, now]),
            gripped=np.array(gripped),
        )  # fmt: skip
        found += [
            (now, failure.kind, failure.vehicle)
            for failure in motion.detect(one, expected(**fields))
        ]
    return found


@pytest.mark.parametrize(("degrees", "found"), [(25.0, []), (38.0, [FailureKind.FALLEN_SILENT])])
def test_a_silent_vehicle_that_pulls_its_neighbour_aside_has_fallen(degrees, found):
    attitude = np.zeros((3, 3))
    attitude[2, 1] = -np.radians(degrees)
    silent = seen(attitude=attitude, received_at=np.array([10.0, 9.4, 10.0]))
    assert kinds(LinkDetector(LIMITS, Latch()).detect(silent, expected())) == found


def test_a_vehicle_that_a_silent_neighbour_turns_over_has_not_fallen():
    """Before the neighbour counts as silent, and after that, the first cause is reported alone."""
    held, moments = [True] * 3, [(10.0, DOWN * 0, OVER * 0, 10.0, [True] * 3)]
    moments += [(now, DOWN, OVER, 10.0, held) for now in np.arange(10.3, 11.3, 0.1).round(1)]
    assert flown(MotionDetector(3, Latch(), cable=True), moments) == [
        (10.6, FailureKind.FALLEN_SILENT, 1)
    ]


@pytest.mark.parametrize("recovers", [True, False])
def test_a_vehicle_that_a_fallen_neighbour_pulls_is_judged_by_whether_it_recovers(recovers):
    motion, free = MotionDetector(3, Latch(), cable=True), [False] * 3
    moments = [(10.0, DOWN * 0, OVER * 0, 10.0, [True] * 3)]
    moments += [(now, DOWN, OVER, now, [True] * 3) for now in (10.1, 10.6, 11.0)]
    moments += [(now, DOWN, OVER, now, free) for now in (11.1, 11.6)]
    if recovers:
        moments += [(now, DOWN * 0, OVER * 0, now, free) for now in (11.7, 11.8, 20.0)]
    else:
        moments += [(now, DOWN, OVER, now, free) for now in (12.2, 12.7, 20.0)]
    found = flown(motion, moments, fallen=frozenset({1}))
    assert found == ([] if recovers else [(12.7, FailureKind.FALLING, 0)])
    # once it is free, nothing pulls it any more
    motion = MotionDetector(3, Latch(), cable=True)
    moments = [(10.0, DOWN * 0, OVER * 0, 10.0, free), (10.1, DOWN, OVER, 10.1, free)]
    assert flown(motion, moments, fallen=frozenset({1})) == [(10.1, FailureKind.FALLING, 0)]


@pytest.mark.parametrize("recovers", [True, False])
def test_a_vehicle_that_lets_go_of_a_caught_strand_is_judged_by_whether_it_recovers(recovers):
    free, opening = [False] * 3, frozenset({0, 1})
    moments = [(10.0, DOWN * 0, OVER * 0, 10.0, free), (10.1, DOWN, OVER, 10.1, free)]
    moments += [(now, DOWN * (not recovers), OVER * 0, now, free) for now in (11.6, 11.7)]
    found = flown(MotionDetector(3, Latch(), cable=True), moments, opening=opening)
    assert found == ([] if recovers else [(11.7, FailureKind.FALLING, 0)])


@pytest.mark.parametrize("cable", [True, False])
def test_nothing_pulls_without_cable(cable):
    moments = [(10.0, DOWN * 0, OVER * 0, 10.0, [True] * 3), (10.1, DOWN, OVER, 10.1, [True] * 3)]
    found = flown(MotionDetector(3, Latch(), cable=cable), moments, fallen=frozenset({1}))
    assert found == ([] if cable else [(10.1, FailureKind.FALLING, 0)])


def test_a_vehicle_that_sinks_slowly_is_judged_by_the_mode_that_it_reports_then():
    """LOITER without a remote control descends at up to 2.5 m/s; free falls are faster."""
    motion = MotionDetector(3, Latch(), cable=True)
    slow = [DOWN * share for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)]
    reports = [
        seen(10.0 + 0.1 * k, velocity=v, mode_at=np.full(3, 10.2)) for k, v in enumerate(slow)
    ]
    assert [one for report in reports for one in motion.detect(report, expected())] == []
    (failure,) = motion.detect(seen(10.7, velocity=DOWN), expected())
    assert failure.message == "vehicle 1 falls: descending at 2.0 m/s"
    motion = MotionDetector(3, Latch(), cable=True)
    alone = expected(streaming=np.array([False, True, True]))
    for report in reports:
        assert motion.detect(report, alone) == []
    motion.detect(seen(10.7, velocity=1.25 * DOWN), alone)
    (failure,) = motion.detect(seen(10.8, velocity=1.25 * DOWN), alone)
    assert failure.message == "vehicle 1 leaves the team: descending at 2.5 m/s"


def test_large_errors_and_short_distances_land_a_flight_that_measures_errors():
    tracking = TrackingDetector(0.5, 1.0)
    off = seen()
    off.measured.error[:] = 0.1, 0.6, 0.2
    (failure,) = tracking.detect(off, expected())
    assert (failure.kind, failure.vehicle) == (FailureKind.TRACKING_ERROR, 1)
    near = PLACES.copy()
    near[2] = near[1] + [0.8, 0.0, 3.0]
    (failure,) = tracking.detect(seen(position=near), expected())
    assert failure.kind is FailureKind.TRACKING_ERROR
    assert "vehicle 2 and vehicle 3 are 0.80 m apart" in failure.message
    assert tracking.detect(off, expected(may_land=np.full(3, True))) == []


@pytest.mark.parametrize(
    ("mode", "kind"),
    [
        ("return", FailureKind.RETURNING),
        ("smart return", FailureKind.RETURNING),
        ("land", FailureKind.LANDING_ALONE),
        ("hold", FailureKind.LEFT_OFFBOARD),
    ],
)
def test_a_vehicle_that_leaves_offboard_mode_fails_by_the_mode_it_takes(mode, kind):
    vehicle = SimpleNamespace(
        mode=mode, in_manual_mode=False, in_mode=lambda _: False, recent_warnings=lambda _: ""
    )
    event = VehicleEvent("mode", f"mode {mode}")
    detector = ReportDetector(compass=True)
    assert kinds(detector.detect(seen(), expected(), 1, vehicle, event, 10.0)) == [kind]
    rejoining = expected(rejoining=frozenset({1}))
    assert detector.detect(seen(), rejoining, 1, vehicle, event, 10.0) == []


def test_a_vehicle_that_has_left_fails_again_only_by_another_mode_or_after_its_return():
    """A PX4 whose setpoints had ended takes one that was under way, and loses them again."""
    detector, outside = (
        ReportDetector(compass=True),
        expected(streaming=np.array([True, False, True])),
    )

    def enters(mode, commanded):
        vehicle = SimpleNamespace(
            mode=mode,
            in_manual_mode=mode == "position",
            in_mode=lambda name: name == mode,
            recent_warnings=lambda _: "",
        )
        event = VehicleEvent("mode", f"mode {mode}")
        return kinds(detector.detect(seen(), commanded, 1, vehicle, event, 10.0))

    assert enters("hold", expected()) == [FailureKind.LEFT_OFFBOARD]
    assert enters("offboard", outside) == enters("hold", outside) == []
    assert enters("position", expected(fallen=frozenset({1}))) == []
    assert enters("position", outside) == [FailureKind.PILOT]
    assert enters("hold", outside) == [FailureKind.LEFT_OFFBOARD]
    assert enters("hold", expected()) == [FailureKind.LEFT_OFFBOARD]


def test_a_hold_ends_after_t_and_a_recovered_hold_begins_anew():
    timeout, held = HoldTimeoutDetector(10.0), expected(holds={OPERATOR: "words"})
    assert timeout.detect(seen(0.0), held) == []
    assert timeout.detect(seen(9.9), held) == []
    assert timeout.detect(seen(9.95), expected()) == []
    assert timeout.detect(seen(10.0), held) == []
    assert timeout.detect(seen(20.0), held) == []
    (failure,) = timeout.detect(seen(20.1), held)
    assert failure.kind is FailureKind.HOLD_TIMEOUT


def test_a_gate_that_is_not_passed_in_time_lands_the_team():
    flight = Network(small_plan()).in_fold(0.0)
    state = branch(flight.conductor, lasting(flight.conductor)).state
    gates = state.setup.gates
    index = next(k for k, gate in enumerate(gates) if gate.condition == "released")
    late = state.now - gates[index].timeout - 1.0
    state.progress = replace(state.progress, gate=index, waiting=True, gate_since=late)
    execute.tick(state)
    assert state.stage is Stage.CONTINGENCY
    (words,) = (e.message for e in state.recorder.take_events() if e.kind == "failure")
    assert words.startswith(f"{FailureKind.GATE_TIMEOUT}: not all are released in ")


@pytest.mark.parametrize(("armed", "found"), [(True, 1), (False, 0)])
def test_a_height_that_is_set_anew_after_disarming_is_no_drift(armed, found):
    # real ArduCopters of a mixed team, which disarm before the PX4 have landed
    detector = HeightDetector(3, Latch())
    assert not detector.detect(seen(now=10.0), expected())
    motors = np.array([True, armed, True])
    moved = seen(now=12.0, height_difference=np.array([0.0, 2.0, 0.0]), armed=motors)
    assert len(detector.detect(moved, expected())) == found


@pytest.mark.parametrize("rate", [-0.1, 0.1, 0.6])
def test_a_height_that_drifts_on_is_corrected_again_and_again(rate):
    detector, corrected = HeightDetector(3, Latch()), 0.0
    for now in np.arange(10.0, 40.0, 0.5).tolist():
        drift = rate * (now - 10.0)
        gap, armed = np.array([0.02, -drift, -0.01]), np.full(3, True)
        for failure in detector.detect(
            seen(now=now, height_difference=gap, armed=armed), expected()
        ):
            assert failure.vehicle == 1
            assert failure.known == (corrected != 0.0)
            detector.follow_frame(1, failure.jump, failure.kind)
            corrected += failure.jump[2]
        if abs(rate) < LARGEST_STEP:
            assert abs(drift - corrected) < 1.2


@pytest.mark.parametrize("commanded", [False, True])
def test_a_height_that_drifts_after_the_command_to_land_is_no_failure(commanded):
    # a real PX4 whose estimate sank by 1.2 m on the ground, in the four seconds before it disarmed
    detector = HeightDetector(3, Latch())
    assert not detector.detect(seen(now=10.0), expected())
    moved = seen(now=12.0, height_difference=np.array([0.0, 1.2, 0.0]))
    found = detector.detect(moved, expected(may_land=np.full(3, commanded)))
    assert len(found) == (not commanded)
