"""A flight of any number of vehicles that ends after any number of samples keeps its outcome."""

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from swarm.certification.certificate import CertifiedPlan, certify
from swarm.certification.contingency_windows import rotors_clear
from swarm.certification.monitor import Monitor
from swarm.flight.adherence import adherence
from swarm.flight.flight_plan import basis_of
from swarm.flight.recorder import Recorder
from swarm.flight.result import FlightResult, Outcome, Statistics
from swarm.flight.trace import Trace
from swarm.formats.samples import sampled_flight
from swarm.formats.table import samples_table
from swarm.mission import parse_mission
from swarm.planning.candidates import make_plan
from swarm.reports.flight_json import outcome_object
from swarm.reports.flight_report import flight_report
from swarm.reports.flight_text import print_outcome
from swarm.reports.plots import flight_figure
from swarm.verification import verify_trace
from swarm.view.replay import write_flight
from tests.shared import shared

FIRST_STEPS = Path(__file__).parents[1] / "missions" / "first-steps"
TEAMS = (1, "hover"), (2, "two_carry"), (3, "pass_over")


@shared
def flown(name: str) -> CertifiedPlan:
    path = FIRST_STEPS / f"{name}.yaml"
    plan = make_plan(parse_mission(path.read_text(), str(path)))
    return CertifiedPlan(plan, certify(plan))


def trace_of(flight_plan: CertifiedPlan, samples: int, phase: str, *, known: bool) -> Trace:
    plan, n = flight_plan.plan, flight_plan.plan.vehicles
    start, recorder = plan.phase("fold").start, Recorder()
    for k in range(samples):
        place = plan.motion.at(start + k)[0] if known else np.full((n, 3), np.nan)
        stray = np.full(len(plan.layout.lengths), 0.01 if known else np.nan)
        recorder.sample((float(k), start + k), (place, place), phase, stray)
    return recorder.trace(n, len(plan.layout.lengths))


@given(n=st.integers(1, 3), segments=st.integers(0, 2), samples=st.integers(0, 2))
def test_a_trace_has_its_shape_whatever_there_is_of_it(n, segments, samples) -> None:
    """Three vehicles may also fly without cable, as in a hop."""
    recorder = Recorder()
    for k in range(samples):
        place = np.zeros((n, 3))
        recorder.sample((float(k), float(k)), (place, place), "", np.zeros(segments))
    trace = recorder.trace(n, segments)
    assert trace.position.shape == trace.setpoint.shape == (samples, n, 3)
    assert trace.stray.shape == (samples, segments)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("n", "name", "samples", "phase", "known"),
    [
        (1, "hover", 0, "", True),
        (1, "hover", 2, "hold", False),
        (2, "two_carry", 1, "fold", True),
        *(
            pytest.param(*team, samples, phase, known, marks=pytest.mark.full)
            for team in TEAMS
            for samples in (0, 1, 2)
            for phase, known in (("", True), ("fold", True), ("hold", False))
        ),
    ],
)
def test_every_reader_of_a_trace_reads_a_short_one(
    n: int, name: str, samples: int, phase: str, known: bool, tmp_path: Path
) -> None:
    flight_plan = flown(name)
    plan, assessment = flight_plan.plan, flight_plan.assessment
    trace = trace_of(flight_plan, samples, phase, known=known)
    basis = basis_of(flight_plan, cable=n > 1)
    ended = Outcome("failed", "not received: vehicle 1")
    counted = Statistics(3.0, 0, None, {}, {}, {})
    kept = adherence(plan, trace, basis)
    result = FlightResult(ended, trace, (), counted, basis, kept)
    verification = verify_trace(plan, trace)
    outcome = outcome_object(plan, result, verification, assessment)
    page = flight_report(plan, assessment, outcome, trace, ())
    printed = io.StringIO()
    print_outcome(plan, result, verification, assessment, Console(file=printed))
    assert all("not received: vehicle 1" in text for text in (page, printed.getvalue()))
    assert samples_table(sampled_flight(plan, trace)).num_rows == samples
    flight_figure(plan, trace)
    write_flight(plan, trace, (), tmp_path / "flight.rrd")


@settings(max_examples=30)
@given(team=st.sampled_from(TEAMS), moments=st.integers(0, 3), data=st.data())
def test_rotors_and_distances_of_any_team_at_any_number_of_moments(team, moments, data) -> None:
    n, plan = team[0], flown(team[1]).plan
    times = data.draw(st.lists(st.floats(0.0, 30.0), min_size=moments, max_size=moments))
    position = plan.motion.at(np.array(times))[0]
    clear = rotors_clear(plan, position)
    assert clear.shape == (moments,)
    assert n > 1 or clear.all()
    for cable in ("free", "floor", "lifting", "aloft"):
        found = Monitor(plan).clearances(position, cable)
        assert len(found) == moments
        assert n > 1 or all(one.vehicle == one.cable == np.inf for one in found)
