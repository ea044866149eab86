"""A flight of any number of vehicles that ends after any number of samples keeps its outcome."""

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from swarm.certification.certificate import CertifiedPlan, certify
from swarm.certification.contingency_windows import above_rotors, rotors_clear
from swarm.certification.monitor import Monitor
from swarm.errors import Refused
from swarm.flight.flight_plan import basis_of
from swarm.flight.result import FlightResult, Outcome, Statistics, adherence
from swarm.flight.snapshot import Recorder
from swarm.flight.trace import Trace
from swarm.formats.samples import sampled_flight
from swarm.formats.table import samples_table
from swarm.mission import parse_mission
from swarm.mission.fleet import emulated_fleet
from swarm.planning.candidates import make_plan
from swarm.reports.flight import flight_report, outcome_object, print_outcome
from swarm.reports.layout_sheet import layout_sheet
from swarm.reports.plan import plan_report
from swarm.reports.plots import flight_figure
from swarm.rope import planned_grips, simulate_rope
from swarm.simulation.spread import Spread, draw
from swarm.verification import verify_trace
from swarm.view.replay import write_flight, write_plan
from tests.shared import shared

FIRST_STEPS = Path(__file__).parents[1] / "missions" / "first-steps"
TEAMS = (1, "hover"), (2, "two_carry"), (3, "pass_over"), (4, "four")
FOUR = """
schema: 1
name: four without cable
formation:
  places:
    - [[0, 0, 3], [2, 0, 3], [4, 0, 3], [6, 0, 3]]
    - [[0, 1, 3], [2, 1, 3], [4, 1, 3], [6, 1, 3]]
vehicles: {max_speed: 1.0}
"""


@shared
def flown(name: str) -> CertifiedPlan:
    path = FIRST_STEPS / f"{name}.yaml"
    text = FOUR if name == "four" else path.read_text()
    plan = make_plan(parse_mission(text, str(path)))
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
    ("name", "samples", "phase", "known"),
    [
        ("hover", 0, "", True),
        ("hover", 2, "hold", False),
        ("two_carry", 1, "fold", True),
        ("four", 2, "hold", True),
        *(
            pytest.param(team[1], samples, phase, known, marks=pytest.mark.full)
            for team in TEAMS
            for samples in (0, 1, 2)
            for phase, known in (("", True), ("fold", True), ("hold", False))
        ),
    ],
)
def test_every_reader_of_a_trace_reads_a_short_one(
    name: str, samples: int, phase: str, known: bool, tmp_path: Path
) -> None:
    flight_plan = flown(name)
    plan, assessment = flight_plan.plan, flight_plan.assessment
    trace = trace_of(flight_plan, samples, phase, known=known)
    basis = basis_of(flight_plan, cable=len(plan.layout.lengths) > 0)
    ended = Outcome("failed", "not received: vehicle 1")
    counted = Statistics(3.0, 0, None, {}, {}, {})
    kept = adherence(plan, trace, basis)
    result = FlightResult(ended, trace, (), counted, basis, kept)
    verification = verify_trace(plan, trace)
    outcome = outcome_object(plan, result, verification, assessment)
    page = flight_report(plan, assessment, outcome, trace, ())
    printed = io.StringIO()
    print_outcome(plan, result, outcome, Console(file=printed))
    assert all("not received: vehicle 1" in text for text in (page, printed.getvalue()))
    assert samples_table(sampled_flight(plan, trace)).num_rows == samples
    flight_figure(plan, trace)
    write_flight(plan, trace, (), tmp_path / "flight.rrd")


@pytest.mark.parametrize("name", ["hover", "four"])
def test_a_plan_without_cable_has_pages_curves_and_trials(name: str, tmp_path: Path) -> None:
    flight_plan = flown(name)
    plan = flight_plan.plan
    assert "<h2>" in plan_report(plan, flight_plan.assessment)
    sheet = layout_sheet(plan)
    assert f">{plan.vehicles}<" in sheet
    assert "cut the cable" not in sheet
    assert "Lay line" not in sheet
    write_plan(plan, tmp_path / "plan.rrd")
    drawn = draw(plan, emulated_fleet(plan.vehicles), Spread(), seed=1, trial=0)
    assert drawn.world.get("cable") is None
    with pytest.raises(Refused, match="the mission has no cable"):
        simulate_rope(plan, planned_grips(plan))


@settings(max_examples=30)
@given(team=st.sampled_from(TEAMS), moments=st.integers(0, 3), data=st.data())
def test_rotors_and_distances_of_any_team_at_any_number_of_moments(team, moments, data) -> None:
    n, plan = team[0], flown(team[1]).plan
    times = data.draw(st.lists(st.floats(0.0, 30.0), min_size=moments, max_size=moments))
    position = plan.motion.at(np.array(times))[0]
    clear = rotors_clear(plan, position)
    assert clear.shape == (moments,)
    assert above_rotors(plan, position).shape == (moments, n, len(plan.layout.lengths))
    assert len(plan.layout.lengths) or clear.all()
    held = ("lifting", "aloft") if n == 1 or len(plan.layout.lengths) else ()
    for cable in ("free", "floor", *held):
        found = Monitor(plan).clearances(position, cable)
        assert len(found) == moments
        assert n > 1 or all(one.vehicle == one.cable == np.inf for one in found)
