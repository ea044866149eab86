"""The certificate covers all held cable, independent of phase names; floor, fence and wind."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from swarm.certification.air import wind_tilt
from swarm.certification.assessment import assess
from swarm.certification.cable_spans import cable_spans, exempt_length
from swarm.certification.clearances import (
    certified,
    tightest_moments,
    violations,
)
from swarm.certification.motion_file import plan_of_motion, read_motion
from swarm.cli.certify import certify
from swarm.errors import InputError
from swarm.exports import motion_rows
from swarm.geometry.catenary import solve_catenaries
from swarm.mission import mission_for_knot
from swarm.planning import Gate, Phase
from tests.certification.oracle import displaced
from tests.certification.synthetic import moving, plan_of

ABOVE = [[-2, 0, 8.0], [2, 0, 8.0], [0, 2.2, 10.75], [0, -1.8, 10.75]]
BELOW = [[-2, 0, 8.0], [2, 0, 8.0], [0, 2.2, 5.25], [0, -1.8, 5.25]]
LENGTHS = [4.6, 5.2, 4.6]


def through_each_other(*names):
    """Vehicles 3 and 4 lower their segment by 5.5 m, through segment 1.

    They rest in the first phase, descend in the second, and rest again.
    """
    edges = [0.0, 2.0, 14.0, 16.0, 18.0]
    motion = moving([0.0, 2.0, 14.0, 16.0], [ABOVE, ABOVE, BELOW, BELOW])
    plan = plan_of(motion, LENGTHS)
    phases = tuple(
        Phase(name, start, end, "free", False)
        for name, start, end in zip(names, edges, edges[1:], strict=False)
    )
    phases = (*phases[:-1], replace(phases[-1], end=16.0))
    return replace(plan, phases=phases)


def command(tmp_path, plan, *options):
    motion, cable = tmp_path / "motion.csv", tmp_path / "cable.json"
    motion.write_text("\n".join(motion_rows(plan)))
    cable.write_text(json.dumps([float(length) for length in plan.layout.lengths]))
    return CliRunner().invoke(certify, [str(motion), "--cable", str(cable), "--json", *options])


def errors(findings):
    return {finding.check for finding in findings if finding.severity == "error"}


@pytest.mark.parametrize("name", ["takeoff", "grab", "descend", "tighten", "land"])
def test_strands_that_pass_through_each_other_under_another_name(tmp_path, name):
    result = command(tmp_path, through_each_other("fold", name, "hold"))
    assert result.exit_code != 0
    assert isinstance(result.exception, InputError)
    places = [str(problem) for problem in result.exception.problems]
    before = {"takeoff", "grab", "land"}
    line = 2 + 4 * 40 if name in before else 2 + 4 * 280
    assert places[0].startswith(
        str(tmp_path / "motion.csv") + f": line {line}, column 12: phase: expected "
    )


def test_strands_that_pass_through_each_other_in_the_fold(tmp_path):
    result = command(tmp_path, through_each_other("fold", "fold", "hold"))
    assert result.exit_code == 1
    checks = {f["check"] for f in json.loads(result.stdout)["findings"] if f["severity"] == "error"}
    assert "strands meet" in checks


@pytest.mark.parametrize(
    ("names", "check"),
    [
        (("fold", "descend"), "straight down"),
        (("fold", "descend", "land"), "phases"),
        (("contract", "lift", "fold"), "drawn out"),
        (("lift", "lift", "fold"), "reach on the floor"),
        (("takeoff", "lift", "fold"), "drawn out"),
        (("fold", "unfold", "lower"), "strands meet"),
    ],
)
def test_a_legal_order_of_phases_does_not_hide_it(names, check):
    plan = through_each_other(*names)
    text = "\n".join(motion_rows(plan))
    imported = plan_of_motion(read_motion(text, "m"), plan.layout.lengths, plan.mission)
    assert check in errors(assess(imported).findings)
    assert not certified(imported, tracking=0.1)


@pytest.mark.parametrize("cable", ["floor", "lifting", "landing", "free"])
def test_the_stated_cable_of_a_phase_is_checked(cable):
    plan = through_each_other("fold", "fold", "hold")
    phases = (Phase("fold", 0.0, 14.0, cable, False), Phase("hold", 14.0, 16.0, "aloft", False))
    found = errors(assess(replace(plan, phases=phases)).findings)
    assert {"phases", "strands meet"} <= found


def test_a_plan_with_a_manually_edited_phase_is_refused(overhand):
    for cable in ("floor", "lifting", "landing", "free"):
        edited = tuple(
            replace(phase, cable=cable) if phase.name == "fold" else phase
            for phase in overhand.phases
        )
        assert cable_spans(replace(overhand, phases=edited)).problems
    assert cable_spans(overhand).problems == ()


@pytest.mark.parametrize(
    "edit",
    [
        lambda plan: replace(plan, phases=()),
        lambda plan: replace(plan, phases=plan.phases[:-1]),
        lambda plan: replace(plan, phases=plan.phases[1:]),
        lambda plan: replace(plan, phases=plan.phases[::-1]),
        lambda plan: replace(plan, gates=(Gate(plan.phase("fold").start, "released", 20.0),)),
        lambda plan: replace(plan, gates=(Gate(plan.phase("hold").end, "gripped", 20.0),)),
    ],
)
def test_phases_and_gates_that_contradict_each_other(overhand, edit):
    assert cable_spans(edit(overhand)).problems


def test_cable_is_gripped_on_the_floor_only(overhand):
    early = {"grab": {"end": 12.0}, "contract": {"start": 12.0}}
    phases = tuple(replace(phase, **early.get(phase.name, {})) for phase in overhand.phases)
    ((message, time),) = cable_spans(replace(overhand, phases=phases)).problems
    assert "grip the cable on the floor, but hold it" in message
    assert time == 12.0


def test_a_knot_that_descends_without_change_keeps_its_certificate():
    high, low = np.add(ABOVE, [0.0, 0.0, 4.0]), np.array(ABOVE)
    crossing = {"crossings": ((2, 0),)}
    plan = plan_of(moving([0.0, 2.0, 14.0], [high, high, low]), LENGTHS, **crossing)
    phases = (
        Phase("hold", 0.0, 2.0, "aloft", False),
        Phase("descend", 2.0, 14.0, "landing", False),
    )
    assert errors(assess(replace(plan, phases=phases)).findings) == set()
    bent = low + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0.05]])
    plan = plan_of(moving([0.0, 2.0, 14.0], [high, high, bent]), LENGTHS, **crossing)
    assert errors(assess(replace(plan, phases=phases)).findings) == {"straight down"}


def test_a_descent_that_brings_strands_nearer_is_refused():
    """By less than 5 mm per vehicle: strands near taut answer tenfold."""

    def descending(by):
        far, near = 4.40575 - by, 4.40575 + by
        high = np.array([[-far, 0, 12], [far, 0, 12], [0, -near, 11.654], [0, near, 11.654]])
        heavy = "vehicles.tracking=0.02", "vehicles.payload=3.0", "vehicles.mass=3.0"
        heavy += ("limits.accept_negative_budget=true",)
        begins = np.array([[-4.40575, 0, 12], [4.40575, 0, 12], [0, -4.40575, 11.654],
                           [0, 4.40575, 11.654]])  # fmt: skip
        down = [0.0, 0.0, 4.0]
        motion = moving([0.0, 4.0, 16.0], [begins, begins, high - down])
        plan = plan_of(motion, [9.0, 14.0, 9.0], *heavy, crossings=((0, 2),))
        phases = (
            Phase("hold", 0.0, 4.0, "aloft", False),
            Phase("descend", 4.0, 16.0, "landing", False),
        )
        return errors(assess(replace(plan, phases=phases)).findings)

    assert descending(0.0) == set()
    assert descending(0.0047) == {"cable clearance"}


def test_phases_leave_no_gap_and_gates_no_time(overhand):
    fold, hold = overhand.phase("fold"), overhand.phase("hold")
    phases = tuple(
        replace(phase, end=np.nextafter(phase.end, 0.0)) if phase is fold else phase
        for phase in overhand.phases
    )
    assert cable_spans(overhand).problems == ()
    assert cable_spans(replace(overhand, phases=phases)).problems
    late = Gate(np.nextafter(hold.end, np.inf), "released", 20.0)
    assert cable_spans(replace(overhand, gates=(late,))).problems


def test_rows_of_one_time_share_a_phase():
    header = "time,vehicle,x,y,z,vx,vy,vz,ax,ay,az,phase"
    rows = [
        f"{time},{vehicle},{2.5 * vehicle},0,5,0,0,0,0,0,0,{phase}"
        for time, vehicle, phase in (
            (0, 1, "fold"), (0, 2, "hold"), (1, 1, "fold"), (1, 2, "fold"),
        )
    ]  # fmt: skip
    with pytest.raises(InputError) as error:
        read_motion("\n".join([header, *rows]), "m.csv")
    assert [str(problem) for problem in error.value.problems] == [
        "m.csv: line 3, column 12: phase: expected fold as for vehicle 1 at that time, got hold"
    ]


def test_one_row_of_a_phase_lasts_to_the_next_row():
    header = "time,vehicle,x,y,z,vx,vy,vz,ax,ay,az,phase"
    rows = [
        f"{time},{vehicle},{2.5 * vehicle},0,5,0,0,0,0,0,0,{phase}"
        for time, phase in ((0, "fold"), (2, "hold"), (5, "finish"))
        for vehicle in (1, 2)
    ]
    motion = read_motion("\n".join([header, *rows]), "m.csv")
    plan = plan_of_motion(motion, np.array([3.0]), mission_for_knot("overhand"))
    assert [(phase.name, phase.start, phase.end) for phase in plan.phases] == [
        ("fold", 0.0, 2.0), ("hold", 2.0, 5.0), ("finish", 5.0, 5.0),
    ]  # fmt: skip
    assert [(gate.time, gate.condition) for gate in plan.gates] == [(5.0, "released")]
    assert cable_spans(plan).aloft == [(0.0, 5.0)]


@pytest.mark.parametrize("depth", [0.01, 3.0])
def test_a_vehicle_below_the_floor_is_refused_in_every_phase(depth):
    places = [[[0, 0, z], [2.5, 0, z]] for z in (5.0, 5.0, -depth)]
    plan = plan_of(moving([0.0, 4.0, 16.0], places), [3.0])
    phases = (Phase("hold", 0.0, 4.0, "aloft", False), Phase("finish", 4.0, 16.0, "free", False))
    broken = assess(replace(plan, phases=phases))
    assert errors(broken.findings) == {"ground"}
    (ground,) = [finding for finding in broken.findings if finding.check == "ground"][:1]
    assert "m below the floor: vehicle 1 (at " in ground.message
    standing = plan_of(moving([0.0, 4.0, 16.0], [*places[:2], [[0, 0, 0.0], [2.5, 0, 0.0]]]), [3.0])
    assert errors(assess(replace(standing, phases=phases)).findings) == set()
    assert violations(replace(standing, phases=phases)) == (), "nothing to repair"


FENCE = "workspace.fence=[[-5,-5],[5,-5],[5,{0}],[-5,{0}]]"


def in_wind(north, steady=6.0):
    """Two vehicles carry 4 m of cable north, up to 3 m north, along a fence."""
    places = [[[-1.5, y, 5.0], [1.5, y, 5.0]] for y in (0.0, 3.0)]
    keys = ("vehicles.tracking=0.05", f"wind.steady={steady}", FENCE.format(north))
    return plan_of(moving([0.0, 8.0], places), [4.0], *keys)


def test_cable_that_the_wind_moves_over_the_fence_is_refused():
    assert errors(assess(in_wind(3.6, 0.0)).findings) == set()
    found = assess(in_wind(3.6)).findings
    assert errors(found) == {"wind"}
    (wind,) = [finding.message for finding in found if finding.check == "wind"]
    assert ": fence of segment 1 and the fence fails (at " in wind
    assert errors(assess(in_wind(9.0)).findings) == set()


@pytest.mark.parametrize("speed", [0.0, 3.0, 6.0])
def test_in_wind_brute_force_never_finds_cable_nearer_to_the_fence_than_certified(speed):
    rng = np.random.default_rng(5)
    plan = in_wind(4.6, speed)
    tilt = wind_tilt(plan, speed)
    moments = tightest_moments(plan, checks=("fence",), tilt=tilt)
    (moment,) = [m for m in moments if m.between[0] == "segment 1"]
    places = displaced(
        rng, np.repeat(plan.motion.at(np.linspace(0.0, 8.0, 50))[0], 40, axis=0), 0.05
    )
    strands = solve_catenaries(places[:, 0], places[:, 1], 4.0, down=(0.0, tilt, -1.0)).points(
        np.linspace(0.0, 1.0, 201)
    )
    sampled = (4.6 - strands[..., 1] - 0.003).min()
    assert moment.distance <= sampled
    assert moment.distance >= 0.93 * sampled - 0.01


def test_in_wind_a_concave_fence_is_checked():
    notch = "workspace.fence=[[-5,-5],[5,-5],[5,5],[0.2,5],[0,3.6],[-0.2,5],[-5,5]]"
    places = [[[-1.5, 3.0, 5.0], [1.5, 3.0, 5.0]]] * 2
    keys = ("vehicles.tracking=0.05", notch)
    still = plan_of(moving([0.0, 2.0], places), [4.0], *keys)
    windy = plan_of(moving([0.0, 2.0], places), [4.0], *keys, "wind.steady=6")
    assert errors(assess(still).findings) == set()
    assert errors(assess(windy).findings) == {"wind"}


def test_an_acceleration_just_above_its_limit_is_refused():
    """A quintic from rest to rest over 6 m in T seconds reaches 5.7735·6/T² m/s²."""
    places = [[[0, 0, 5.0], [2.5, 0, 5.0]], [[6, 0, 5.0], [8.5, 0, 5.0]]]
    for share, wrong in ((1.0017, {"acceleration"}), (1.0003, {"acceleration"}), (0.9999, set())):
        duration = np.sqrt(10.0 / np.sqrt(3.0) * 6.0 / share)
        assert errors(assess(plan_of(moving([0, duration], places), [3.0])).findings) == wrong


@pytest.mark.slow
def test_the_scope_states_grip_release_and_exempt_length(overhand, overhand_assessed):
    (scope,) = [f.message for f in overhand_assessed.findings if f.check == "scope"]
    beyond = exempt_length(overhand)
    assert f"{beyond:.2f} m of cable from its grip (at most 50% of the shorter one)" in scope
    assert "all vehicles hold the cable until 224.7 s" in scope
    tightened = through_each_other("fold", "tighten")
    (scope,) = [f.message for f in assess(tightened).findings if f.check == "scope"]
    assert "all vehicles hold the cable until 2.0 s" in scope


def test_certified_agrees_with_the_findings_for_whole_flights(overhand):
    """Standing on the floor and rigid descents have the smallest margins."""
    assert certified(overhand, tracking=0.1)
    assert certified(overhand, tracking=0.1, tilt=wind_tilt(overhand, 1.0))
    high, low = np.add(ABOVE, [0.0, 0.0, 4.0]), np.array(ABOVE)
    plan = plan_of(moving([0.0, 2.0, 14.0], [high, high, low]), LENGTHS)
    phases = (
        Phase("hold", 0.0, 2.0, "aloft", False),
        Phase("descend", 2.0, 14.0, "landing", False),
    )
    assert certified(replace(plan, phases=phases), tracking=0.1)
