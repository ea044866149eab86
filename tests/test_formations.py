"""Missions without a knot: formations with or without cable, planned, checked and flown."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from swarm.certification.assessment import assess
from swarm.certification.certificate import CertifiedPlan, certify
from swarm.errors import InputError, Refused
from swarm.mission import Mission, parse_mission
from swarm.planning.candidates import make_plan
from swarm.verification import verify_trace
from tests.command import run
from tests.network import Network

FIRST_STEPS = Path(__file__).parents[1] / "missions" / "first-steps"
PAIR = "[[0, 0, 3], [3, 0, 3]]"


def mission(keys: str) -> Mission:
    return parse_mission(f"{{schema: 1, name: steps, {keys}}}", "m.yaml")


def refusal(keys: str) -> str:
    with pytest.raises(InputError) as caught:
        mission(keys)
    return str(caught.value)


def test_a_plan_without_cable_carries_none() -> None:
    path = FIRST_STEPS / "hover.yaml"
    plan = make_plan(parse_mission(path.read_text(), str(path)))
    basis = Network(CertifiedPlan(plan, certify(plan))).conductor.basis
    assert basis.words == "certified for tracking errors of up to 0.1 m; no cable is carried"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["hover", "two_carry", pytest.param("pass_over", marks=pytest.mark.full)]
)
def test_first_steps_are_certified_and_flown_to_their_end(name: str) -> None:
    path = FIRST_STEPS / f"{name}.yaml"
    plan = make_plan(parse_mission(path.read_text(), str(path)))
    flight_plan = CertifiedPlan(plan, certify(plan))
    network = Network(flight_plan)
    outcome = network.run(most=600.0)
    assert outcome is not None
    assert outcome.word == "done", network.words()[-8:]
    trace = network.conductor.trace()
    assert float(np.ptp(trace.time)) == pytest.approx(plan.flight_duration, rel=0.03)
    flown = verify_trace(plan, trace)
    assert (flown.knot, flown.as_planned, flown.notes) == ("0_1", True, ())
    fold = [error for error in flown.tracking if error.phase == "fold"]
    assert max(error.largest for error in fold) < plan.mission.vehicles.tracking


def test_every_formation_is_reached_at_rest() -> None:
    path = FIRST_STEPS / "pass_over.yaml"
    described = parse_mission(path.read_text(), str(path))
    assert described.formation is not None
    plan = make_plan(described)
    fold = plan.phase("fold")
    times = np.arange(fold.start, fold.end, 0.02)
    place, velocity, _ = plan.motion.at(times)
    still = np.linalg.norm(velocity, axis=2).max(axis=1) < 1e-9
    for wanted in described.formation.places:
        off = np.abs(place[still] - np.array(wanted)).max(axis=(1, 2))
        assert off.min() < 1e-9


def test_a_segment_that_is_too_short_for_a_formation_is_reported() -> None:
    with pytest.raises(Refused) as caught:
        make_plan(
            mission(f"formation: {{places: [{PAIR}, [[0, 0, 3], [9, 0, 3]]], lengths: [4.0]}}")
        )
    assert str(caught.value) == (
        "formation 2 has vehicles 1 and 2 9.00 m apart, but formation.lengths gives them 4.00 m of "
        "cable"
    )


def test_vehicles_alone_may_fly_in_formation_and_are_kept_apart() -> None:
    near = "[[0, 0, 3], [0.5, 0, 3]]"
    plan = make_plan(mission(f"formation: {{places: [{PAIR}, {near}]}}"))
    assert [finding.check for finding in assess(plan).findings if finding.severity == "error"] == [
        "vehicle clearance"
    ]
    assert assess(make_plan(mission(f"formation: {{places: [{PAIR}]}}"))).cleared


def test_three_vehicles_without_cable_are_certified_and_flown() -> None:
    """With two, empty arrays of segments happen to fit; with three they did not."""
    places = "[[0, 0, 3], [2.5, 0, 3], [5, 0, 3]]", "[[0, 0, 4], [2.5, 2, 4], [5, 0, 4]]"
    plan = make_plan(mission(f"formation: {{places: [{', '.join(places)}]}}"))
    network = Network(CertifiedPlan(plan, certify(plan)))
    outcome = network.run(most=600.0)
    assert outcome is not None
    assert outcome.word == "done", network.words()[-8:]
    assert not network.conductor.basis.cable


CARRIED = f"formation: {{places: [{PAIR}, [[0, 2, 3], [3, 2, 3]]], lengths: [3.6]}}"


def test_a_table_beside_the_team_does_not_stop_it() -> None:
    table = "{name: table, shape: box, centre: [1.5, -2], size: [1.2, 0.8], top: 0.75}"
    plan = make_plan(mission(f"{CARRIED}, workspace: {{obstacles: [{table}]}}"))
    without = make_plan(mission(CARRIED))
    assert np.array_equal(plan.motion.coefficients, without.motion.coefficients)
    flight_plan = CertifiedPlan(plan, certify(plan))
    outcome = Network(flight_plan).run(most=600.0)
    assert outcome is not None
    assert outcome.word == "done"


def test_a_truss_in_the_way_is_refused_by_name_with_place_and_time(tmp_path: Path) -> None:
    """Two metres of way at 3 m of height; the cable hangs 0.85 m below, over a truss at 2.5 m."""
    truss = "{name: truss, shape: box, centre: [1.5, 1], size: [4, 0.2], bottom: 2.4, top: 2.6}"
    path = tmp_path / "hall.yaml"
    path.write_text(f"{{schema: 1, name: hall, {CARRIED}, workspace: {{obstacles: [{truss}]}}}}")
    said = run("plan", str(path), "--json")
    assert said.returncode == 1
    errors = [one for one in json.loads(said.stdout)["findings"] if one["severity"] == "error"]
    assert errors
    for error in errors:
        assert error["check"] == "obstacle"
        assert re.fullmatch(
            r"0\.\d{3} m too near obstacle truss: (segment 1|vehicle [12]) for tracking errors up to "
            r"0\.1 m; move it, or the mission's origin away from it \(at \d+\.\d\d s, near "
            r"\(-?\d\.\d\d, [01]\.\d\d, [12]\.\d\d\)\)",
            error["message"],
        ), error["message"]
    assert any("segment 1" in error["message"] for error in errors)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            "finish: hold",
            "m.yaml: expected exactly one of knot and formation, got none; for example: knot: {name: overhand}",
        ),
        (
            f"knot: {{name: 4_1}}, formation: {{places: [{PAIR}]}}",
            "m.yaml: expected exactly one of knot and formation, got both; for example: knot: {name: overhand}",
        ),
        (
            "formation: {places: []}",
            "m.yaml:1: formation: expected at least one formation of at least one vehicle, got none",
        ),
        (
            f"formation: {{places: [{PAIR}, [[0, 0, 3]]]}}",
            "m.yaml:1: formation: expected 2 places in every formation, got 1 in the 2.",
        ),
        (
            "formation: {places: [[[0, 0, 0]]]}",
            "m.yaml:1: formation: expected every place above the floor (z > 0)",
        ),
        (
            f"formation: {{places: [{PAIR}], lengths: [4, 4]}}",
            "m.yaml:1: formation: expected 1 lengths for 2 vehicles (or none), got 2",
        ),
        (
            f"formation: {{places: [{PAIR}], lengths: [-4]}}",
            "m.yaml:1: formation: expected every length > 0 in metres",
        ),
        (
            f"formation: {{places: [{PAIR}]}}, layout: {{cell: 2}}, fold: {{method: paper}}",
            "m.yaml: expected no fold and no layout with a formation",
        ),
        (
            f"formation: {{places: [{PAIR}]}}, finish: hold",
            "m.yaml: expected no finish in a formation without cable",
        ),
        (
            f"formation: {{places: [{PAIR}], lengths: [4]}}, finish: tighten",
            "m.yaml: expected finish: tighten with three vehicles or more, got two",
        ),
    ],
)
def test_invalid_formations(keys: str, message: str) -> None:
    assert refusal(keys) == message
