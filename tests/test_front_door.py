"""The public API: imported at first use, documented, with errors that name wrong arguments."""

import inspect
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import swarm
from swarm.planning import digest
from swarm.version import __version__
from tests.network import sideways, small_plan, uncleared
from tests.overhand import planned_overhand

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "rerun",
    "matplotlib",
    "pyarrow",
    "pydantic",
    "rich",
    "click",
    "sitl",
)


def python(code):
    done = subprocess.run(
        [sys.executable, *code], capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout + done.stderr


@cache
def held():
    """A small plan as a user holds it, with its certificate."""
    plan = swarm.Plan.of(small_plan().plan)
    return plan, small_plan().certificate


def test_importing_the_package_loads_no_library():
    loaded = python(["-c", "import sys, swarm; print(*sys.modules)"]).split()
    assert "swarm" in loaded
    assert not {name.partition(".")[0] for name in loaded} & set(LIBRARIES)


def test_importing_the_package_takes_at_most_50_ms():
    took = []
    for _ in range(3):
        lines = python(["-X", "importtime", "-c", "import swarm"]).splitlines()
        (line,) = [line for line in lines if line.endswith("| swarm")]
        took.append(int(line.split("|")[1]))  # microseconds, with what it imports
    assert min(took) <= 50_000


def test_every_public_name_is_there_and_listed():
    assert swarm.__version__ == __version__
    for name in swarm.__all__:
        assert getattr(swarm, name) is not None
        assert name in dir(swarm)
    with pytest.raises(AttributeError, match="module 'swarm' has no attribute 'plam'"):
        swarm.plam  # noqa: B018


def test_type_checkers_see_the_same_names():
    source = inspect.getsource(swarm)
    told = source[source.index("if TYPE_CHECKING:") : source.index("else:")]
    names = {
        name.strip()
        for line in told.splitlines()[1:]
        if " import " in line
        for name in line.partition(" import ")[2].split(",")
    }
    assert names | {"__version__"} == set(swarm.__all__)
    assert set(swarm._HOME) == names


FUNCTIONS = [name for name in swarm.__all__ if inspect.isfunction(getattr(swarm, name))]
OWN = [swarm.Cable, swarm.Flight, swarm.Motion, swarm.Plan, swarm.Recording, swarm.Trials]
METHODS = [
    pytest.param(method, id=f"{kind.__name__}.{name}")
    for kind in OWN
    for name, method in vars(kind).items()
    if not name.startswith("_") and callable(getattr(method, "__func__", method))
]  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_document_arguments_errors_and_source(name):
    function = getattr(swarm, name)
    text = inspect.getdoc(function)
    for argument in inspect.signature(function).parameters:
        if argument not in {"path", "plan", "certificate", "mission", "curve", "motion"}:
            assert f"``{argument}" in text, argument
    for word in ("Raises :class:`swarm.", "Source: "):
        assert word in text


@pytest.mark.parametrize("method", METHODS)
def test_methods_are_documented(method):
    assert len(inspect.getdoc(method)) > 40


def test_reprs_are_short_and_have_the_figures():
    plan, certificate = held()
    flight = swarm.simulate(plan, certificate)
    assert repr(plan) == "<Plan 3_1: 0_1, 3 vehicles, 7.2 m of cable, 67 s>"
    assert repr(certificate) == "<Certificate: cleared for 0.1 m>"
    assert repr(plan.motion).startswith("<Motion of 3 grip points: 54 s in ")
    assert repr(flight).startswith("<Flight 3_1: done, 0_1, tracking error 0.")
    mission = swarm.Mission.for_knot("m3_1", tracking=0.05)
    assert repr(mission) == str(mission)
    assert repr(mission) == "<Mission m3_1: m3_1, tracking errors up to 0.05 m, finish release>"
    for shown in (mission, plan, certificate, flight):
        assert shown._repr_html_().startswith("<div><strong>")


def test_text_in_notebooks_is_escaped():
    mission = swarm.Mission.for_knot("3_1", name="<script>&")
    assert "<script>" not in mission._repr_html_()
    assert "&lt;script&gt;&amp;" in mission._repr_html_()


def test_figures_of_certificates_are_rounded_down():
    found = planned_overhand().certified().certificate
    told = re.fullmatch(r"<Certificate: cleared for 0.1 m, e\* (.*) m, w\* (.*) m/s>", repr(found))
    for words, held_for, step in zip(
        told.groups(), (found.max_tracking_error, found.max_wind), (0.01, 0.1), strict=True
    ):
        assert float(words) <= held_for < float(words) + step * (1.0 + 1e-9)


def test_a_plan_and_its_file_keep_the_certificate(tmp_path):
    plan, certificate = held()
    plan.save(tmp_path / "a.plan")
    again = swarm.load_plan(tmp_path / "a.plan")
    assert isinstance(again, swarm.Plan)
    assert certificate.of(again)
    assert digest(again) == digest(plan)
    with pytest.raises(swarm.InputError, match=r"b\.plan: no such file"):
        swarm.load_plan(tmp_path / "b.plan")
    with pytest.raises(swarm.InputError, match="no such file"):
        plan.save(tmp_path / "none" / "a.plan")


def test_a_plan_that_is_not_cleared_is_refused_with_every_reason():
    missions = Path(__file__).parents[1] / "missions"
    low = swarm.load(missions / "first-steps" / "two_carry.yaml", "workspace.ceiling=4")
    with pytest.raises(swarm.NotCleared) as refusal:
        swarm.plan(low)
    found = refusal.value.certificate
    errors = [each for each in found.findings if each.severity == "error"]
    assert len(errors) > 1
    assert str(refusal.value).splitlines() == [f"{each.check}: {each.message}" for each in errors]
    assert not found.cleared
    assert found.of(refusal.value.plan)
    assert repr(found) == f"<Certificate: not cleared for 0.1 m, {len(errors)} errors>"


def test_a_plan_with_the_certificate_of_another_plan_is_refused():
    plan, certificate = held()
    other = swarm.Plan.of(sideways(height=6.0))
    for fly in (swarm.simulate, swarm.monte_carlo):
        with pytest.raises(swarm.Refused, match="the certificate belongs to another plan"):
            fly(other, certificate)
    wrong = uncleared("clearance.vehicle=3.5")
    with pytest.raises(swarm.Refused, match="vehicle clearance: "):
        swarm.simulate(wrong.plan, wrong.certificate)
    with pytest.raises(swarm.InputError) as error:
        swarm.monte_carlo(plan, certificate, trials=0, jobs=0)
    assert [problem.place for problem in error.value.problems] == ["trials", "jobs"]


@pytest.mark.slow
def test_a_flight_has_its_implied_knot_and_tracking_error(tmp_path):
    plan, certificate = held()
    flight = swarm.simulate(plan, certificate, seed=3)
    again = swarm.simulate(plan, certificate, seed=3)
    assert (flight.outcome, flight.knot, flight.as_planned) == ("done", "0_1", True)
    assert flight.within_certificate
    np.testing.assert_array_equal(flight.trace.position, again.trace.position)
    assert flight.clearance["vehicle"].distance >= flight.clearance["vehicle"].required
    error = np.linalg.norm(flight.trace.position - flight.trace.setpoint, axis=-1)
    assert 0.0 < flight.tracking_error <= np.nanmax(error)
    flight.plot().savefig(tmp_path / "flight.png")
    assert (tmp_path / "flight.png").stat().st_size > 10_000


@pytest.mark.slow
def test_trials_are_a_sequence_and_a_table(tmp_path, monkeypatch):
    plan, certificate = held()
    shares = []
    trials = swarm.monte_carlo(
        plan, certificate, trials=2, jobs=1, seed=4, progress=lambda _, share: shares.append(share)
    )
    assert shares == [0.5, 1.0]
    assert [trial.number for trial in trials] == [0, 1]
    assert trials[1] is list(trials)[1]
    assert repr(trials).startswith("<Trials 3_1: 2 flown, ")
    table = trials.to_arrow()
    assert table.num_rows == len(trials)
    assert table["cable"].to_pylist() == [trial.distances["cable"] for trial in trials]
    trials.to_parquet(tmp_path / "trials.parquet")
    import pyarrow.parquet as pq

    assert pq.read_table(tmp_path / "trials.parquet").equals(table)
    frame = trials.to_pandas()
    assert list(frame.columns) == trials.to_arrow().column_names
    assert len(frame) == len(trials)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(swarm.SwarmError, match="needs pandas: pip install pandas"):
        trials.to_pandas()
    assert trials.summary()["trials"] == 2
    trials.plot().savefig(tmp_path / "trials.png")


def test_an_external_trajectory_is_certified_as_its_plan(tmp_path):
    plan, certificate = held()
    plan.to_csv(tmp_path / "mine.csv")
    motion = swarm.Motion.from_csv(tmp_path / "mine.csv")
    np.testing.assert_allclose(motion(20.0)[0], plan.motion(20.0)[0], atol=1e-4)
    cable = swarm.Cable(lengths=[3.6, 3.6])
    found = swarm.certify(motion, cable=cable, mission=plan.mission, robustness=False)
    assert found.cleared
    certified, again = (
        each.assessment.distances["vehicle"].distance for each in (certificate, found)
    )
    assert again == pytest.approx(certified, abs=0.01)
    foreign = motion.plan(cable, plan.mission)
    assert found.of(foreign)
    with pytest.raises(swarm.Refused, match="an external trajectory can be certified, not flown"):
        swarm.simulate(foreign, found)


def test_a_cable_overrides_the_cable_of_the_mission():
    mission = swarm.Mission.for_knot("3_1", cable={"diameter": 0.02, "mass_per_length": 0.05})
    thick = swarm.Cable([3.4], mass_per_length=0.06).section(mission.cable)
    assert (thick.diameter, thick.mass_per_length) == (0.02, 0.06)
    with pytest.raises(swarm.InputError, match="cable: segment 2: expected a length > 0 and"):
        swarm.Cable(lengths=[3.4, -1.0])
    with pytest.raises(swarm.InputError, match="cable: expected the lengths of segments, got none"):
        swarm.Cable(lengths=[])
    with pytest.raises(swarm.InputError, match=r"cable: diameter: expected a length > 0 in metres"):
        swarm.Cable(lengths=[3.4], diameter=-1.0)


def test_a_cable_is_only_accepted_with_a_motion(tmp_path):
    plan, _ = held()
    plan.to_csv(tmp_path / "mine.csv")
    motion = swarm.Motion.from_csv(tmp_path / "mine.csv")
    with pytest.raises(swarm.InputError, match=r"cable: expected swarm\.Cable"):
        swarm.certify(motion)
    with pytest.raises(swarm.InputError, match="cable: expected none: a plan has its own"):
        swarm.certify(plan, cable=swarm.Cable([3.6, 3.6]))
    with pytest.raises(swarm.InputError, match="cable: expected 2 segments for 3 vehicles, got 1"):
        swarm.certify(motion, cable=swarm.Cable([3.6]))


def test_missions_are_read_with_every_problem_at_its_key(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("schema: 1\nname: a\nknot: {name: 3_99}\n")
    with pytest.raises(swarm.InputError, match=r"a\.yaml:3: knot\.name: "):
        swarm.load(path)
    path.write_text("schema: 1\nname: a\nknot: {name: 3_1, chirality: left}\n")
    assert swarm.load(path, "vehicles.tracking=0.07").vehicles.tracking == 0.07
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(swarm.InputError, match=r"a\.yaml: expected UTF-8 text"):
        swarm.load(path)
    with pytest.raises(swarm.InputError, match=r"3_1: vehicles\.tracking: expected a length >= 0"):
        swarm.Mission.for_knot("3_1", tracking=-1.0)
    with pytest.raises(swarm.InputError, match=r"3_1: vehicles\.tracking: expected this key or"):
        swarm.Mission.for_knot("3_1", tracking=0.1, vehicles={"tracking": 0.2})
    quick = swarm.Mission.for_knot("3_1", tracking=0.2, vehicles={"max_speed": 3.0})
    assert (quick.vehicles.tracking, quick.vehicles.max_speed) == (0.2, 3.0)
    with pytest.raises(swarm.InputError, match="3_1: vehicles: expected a mapping of keys"):
        swarm.Mission.for_knot("3_1", tracking=0.1, vehicles="quick")
    same = swarm.Mission.for_knot("3_1", clearance=quick.clearance)
    assert same.clearance == quick.clearance


def trefoil():
    turn = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    x, y = np.sin(turn) + 2 * np.sin(2 * turn), np.cos(turn) - 2 * np.cos(2 * turn)
    return np.column_stack([x, y, -np.sin(3 * turn)])


def test_curves_are_named_with_their_chirality():
    curve = trefoil()
    hand = swarm.identify(curve, closed=True)
    mirrored = swarm.identify(curve * [1.0, 1.0, -1.0], closed=True)
    assert {hand, mirrored} == {"3_1 right-handed", "3_1 left-handed"}
    assert swarm.identify([[0, 0, 0], [1, 0, 0], [1, 1, 1]]) == "0_1"
    for wrong in ([[0, 0], [1, 1]], [[0, 0, 0]], "curve", [[0, 0, 0], [1]]):
        with pytest.raises(swarm.InputError):
            swarm.identify(wrong)


def test_a_view_without_a_display_writes_the_recording_and_warns(tmp_path, monkeypatch):
    monkeypatch.setattr("swarm.view.viewers.has_display", lambda: False)
    plan, _ = held()
    with pytest.warns(UserWarning, match="no display here"):
        recording = plan.view(tmp_path / "plan.rrd")
    assert recording.path.stat().st_size > 10_000
    assert repr(recording) == f"<Recording {tmp_path / 'plan.rrd'}: not shown>"
    with pytest.raises(swarm.InputError, match="no such file"):
        plan.view(tmp_path / "none" / "plan.rrd")
    with pytest.raises(ValueError, match="picture: expected knot or schedule, got 'map'"):
        plan.plot("map")


def test_an_empty_mission_file_is_refused_with_its_name(tmp_path):
    path = tmp_path / "empty.yaml"
    path.write_text("")
    with pytest.raises(swarm.InputError) as caught:
        swarm.load(path)
    assert str(caught.value) == f"{path}: expected a mapping of keys, got None"
