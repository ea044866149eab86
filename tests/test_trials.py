"""Trials: drawn conditions, reproducibility and statistics."""

import io
import json
import math
import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from swarm.certification.certificate import CertifiedPlan, certify
from swarm.errors import InputError, Refused, SwarmError
from swarm.flight.setup import FlightOptions
from swarm.front.trials import fly_series
from swarm.ground.fly import fly
from swarm.mission import parse_mission
from swarm.mission.fleet import emulated_fleet
from swarm.planning.candidates import make_plan
from swarm.reports.trials import print_trials
from swarm.simulation.spread import Spread, draw, read_scenario, trial_scenario_schema
from swarm.simulation.summaries import (
    CertifiedClearances,
    below_certificate,
    certify_clearances,
    summary,
    worst_trials,
)
from swarm.simulation.trials import DISTANCES as EVERY_DISTANCE
from swarm.simulation.trials import Trial, fly_trial, fly_trials, workers_starting, write_results
from tests.children import children
from tests.network import small_plan, uncleared
from tests.shared import shared

FLIGHT_PLAN = small_plan(vehicles=4)
PLAN = FLIGHT_PLAN.plan
FLEET = emulated_fleet(4)
HOVER = "{schema: 1, name: hover, formation: {places: [[[0, 0, 3]], [[2, 0, 3]]]}}"
CALM = Spread(wind=0, gust=0, loss=0, latency=0, jitter=0, mass=0, grip=0, length=0, failing=0)


@shared
def flown(number: int) -> Trial:
    return fly_trial(FLIGHT_PLAN, Spread(failing=0), 5, number)[0]


DISTANCES = {"cable": 0.5, "vehicle": 2.0, "vehicle_cable": 0.6, "emulated_cable": 0.5}


def trial(number: int = 0, *, distances=(), **changed) -> Trial:
    usual = Trial(
        number=number, outcome="done", reason="", explanation="", knot="0_1", as_planned=True,
        distances={**dict.fromkeys(EVERY_DISTANCE), **DISTANCES, **dict(distances)}, tracking_error=0.05, rotor_strikes=0, collisions=0,
        crashes=0, wind=0.1, gust=0.0, failure="", failure_time=None, duration=100.0,
    )  # fmt: skip
    return replace(usual, **changed)


def test_seed_and_number_determine_a_trial():
    spread = Spread(failing=0.5)
    one, again = (draw(PLAN, FLEET, spread, 3, 7) for _ in range(2))
    assert one == again
    assert one != draw(PLAN, FLEET, spread, 3, 8)
    assert one != draw(PLAN, FLEET, spread, 4, 7)


def test_drawn_conditions_are_within_the_spread():
    spread = Spread(failing=0.5)
    drawn = [draw(PLAN, FLEET, spread, 1, k) for k in range(200)]
    assert 0.4 < max(one.wind for one in drawn) <= spread.wind
    assert max(one.gust for one in drawn) <= spread.gust
    assert 70 <= sum(bool(one.failure) for one in drawn) <= 130
    tolerance, mass = PLAN.mission.cable.length_tolerance, PLAN.mission.vehicles.mass
    for one in drawn:
        points = np.array(one.world["cable"]["points"])
        laid = np.linalg.norm(np.diff(points, axis=0), axis=1).reshape(-1, 2).sum(axis=1)
        assert np.abs(laid - PLAN.layout.lengths).max() <= tolerance + 4 * spread.grip + 1e-9
        masses = np.array([vehicle["mass"] for vehicle in one.world["vehicles"]])
        assert np.abs(masses / mass - 1.0).max() <= 2 * spread.mass + 1e-9
        links = [fault for fault in one.faults if fault.kind == "link" and fault.at == 0]
        assert len(links) == 4
        assert max(fault.latency for fault in links) <= spread.latency
    calm = draw(PLAN, FLEET, CALM, 1, 0)
    assert (calm.wind, calm.failure, calm.faults) == (0.0, "", ())


def test_a_stronger_wind_of_the_mission_widens_the_spread():
    windy = small_plan("wind.steady=3.0", vehicles=3).plan
    assert max(draw(windy, emulated_fleet(3), Spread(), 1, k).wind for k in range(50)) > 2.0


@pytest.mark.slow
def test_a_trial_measures_the_true_positions():
    one = flown(0)
    assert (one.outcome, one.reason, one.completed) == ("done", "", True)
    assert one.tracking_error is not None
    assert 0.01 < one.tracking_error < 0.3
    assert one.distances["cable"] is not None
    assert one.distances["emulated_cable"] == pytest.approx(one.distances["cable"], abs=0.1)
    assert one.rotor_strikes == one.collisions == one.crashes == 0


def test_a_trial_without_cable_is_completed_as_planned():
    plan = make_plan(parse_mission(HOVER, "hover.yaml"))
    one, _ = fly_trial(CertifiedPlan(plan, certify(plan)), CALM, 1, 0)
    assert (one.outcome, one.reason, one.knot, one.as_planned) == ("done", "", "0_1", True)


@pytest.mark.slow
def test_trials_in_processes_are_the_trials_flown_alone():
    """In processes that have been started before."""
    answer = signal.getsignal(signal.SIGINT)
    with workers_starting(2):
        assert signal.getsignal(signal.SIGINT) is answer
    together = {
        t.number: t
        for t in fly_trials(FLIGHT_PLAN, Spread(failing=0), seed=5, trials=[0, 1], jobs=2)
    }
    assert together == {0: flown(0), 1: flown(1)}
    alone, shared = (certify_clearances(PLAN, [flown(0)], jobs) for jobs in (1, 2))
    assert np.array_equal(alone.tracking_radius, shared.tracking_radius)
    for name, bounds in alone.distances.items():
        assert np.array_equal(bounds, shared.distances[name])


@pytest.mark.slow
def test_trials_before_the_death_of_a_worker_are_kept():
    killed = []

    def kill(_done: int) -> None:
        if not killed:
            killed.append(children("loky.backend.popen_loky_posix")[0])
            os.kill(killed[0], signal.SIGKILL)

    flown, ended = fly_series(FLIGHT_PLAN, CALM, trials=40, seed=5, jobs=2, on_trial=kill)
    assert 1 <= len(flown) < 40
    assert type(ended) is SwarmError
    assert str(ended) == "a worker process was killed (too little memory for as many --jobs?)"


def test_an_interrupt_while_processes_start_gives_no_warning(recwarn):
    with pytest.raises(KeyboardInterrupt), workers_starting(2):
        raise KeyboardInterrupt
    assert not recwarn.list


@pytest.mark.slow
def test_trials_on_a_cluster_are_the_trials_flown_alone(monkeypatch):
    monkeypatch.setitem(sys.modules, "snappy", None)  # SnapPy is not the compressor of that name
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        on_cluster = fly_trials(
            FLIGHT_PLAN, Spread(failing=0), seed=5, trials=[1], scheduler=address
        )
        assert {t.number: t for t in on_cluster} == {1: flown(1)}


def test_a_scheduler_that_does_not_answer_is_an_error():
    with pytest.raises(SwarmError, match="no Dask scheduler at tcq://nowhere:1"):
        next(fly_trials(FLIGHT_PLAN, CALM, seed=1, trials=[0], scheduler="tcq://nowhere:1"))


def test_a_lost_vehicle_is_reported():
    spread = CALM.model_copy(update={"failing": 1.0, "failures": ("motor_loss",)})
    seed = next(
        s for s in range(99) if 25 < (draw(PLAN, FLEET, spread, s, 0).failure_time or 0) < 60
    )
    one, result = fly_trial(FLIGHT_PLAN, spread, seed, 0)
    assert one.failure.endswith("motor_loss")
    assert (one.outcome, one.completed) == ("failed", False)
    assert one.reason
    assert one.explanation == result.outcome.explanation


def test_shares_have_exact_intervals():
    document = summary(PLAN, [trial(k) for k in range(20)], seed=1, spread=CALM)
    completed = document["without_failure"]["completed"]
    assert completed["count"] == 20
    assert completed["interval"] == pytest.approx([0.025 ** (1 / 20), 1.0])


def test_quantiles_have_distribution_free_intervals():
    trials = [trial(k, distances={"cable": 0.01 * k}) for k in range(100)]
    document = summary(PLAN, trials, seed=1, spread=CALM)["without_failure"]["clearance"]["cable"]
    assert (document["smallest"], document["required"]) == (0.0, PLAN.mission.clearance.cable)
    low, high = document["quantiles"]["0.5"]["interval"]
    # by hand: P(39 < Binomial(100, ½) < 61) is at least 95 %
    assert (low, high) == pytest.approx((0.39, 0.60))
    assert document["quantiles"]["0.05"]["interval"][0] == pytest.approx(0.0)


def test_trials_with_a_failure_are_counted_separately():
    trials = [
        trial(0),
        trial(
            1, failure="vehicle 2: link", outcome="failed", reason="lost", distances={"cable": None}
        ),
    ]
    document = summary(PLAN, trials, seed=1, spread=CALM)
    assert document["without_failure"]["trials"] == document["with_failure"]["trials"] == 1
    assert document["reasons"] == {"lost": 1}
    assert document["worst"][0]["trial"] == 1
    json.dumps(document, allow_nan=False)


def test_trials_with_contacts_are_the_worst():
    trials = [
        trial(0, distances={"cable": 0.2}),
        trial(1, rotor_strikes=1),
        trial(2, reason="lost", outcome="failed"),
    ]
    assert [one.number for one in worst_trials(PLAN, trials)] == [1, 2, 0]


def test_a_trial_below_its_certificate_is_found():
    table = np.array([0.6, 0.4])
    certified = CertifiedClearances(
        np.array([0.05, 0.1]),
        {"cable": table, "vehicle": table, "vehicle_cable": table - 1.0},
    )
    fine, low, wild = (
        trial(0, distances={"cable": 0.61}),
        trial(1, distances={"cable": 0.59}),
        trial(2, distances={"cable": 0.0}, tracking_error=0.5),
    )
    assert certified.at(0.05, "cable") == 0.6
    assert certified.at(0.06, "cable") == 0.4
    assert certified.at(0.2, "cable") == -math.inf
    assert below_certificate([fine, low, wild], certified) == [1]


def test_a_scenario_has_a_spread_and_faults():
    spread, faults = read_scenario(
        "schema: 1\nspread: {wind: 2.0, failures: [reboot]}\n"
        "faults: [{at: 5, kind: wind, steady: [1, 0, 0]}]", "storm.yaml",
    )  # fmt: skip
    assert (spread.wind, spread.failures, spread.loss) == (2.0, ("reboot",), Spread().loss)
    assert [fault.kind for fault in faults] == ["wind"]
    assert read_scenario("schema: 1", "plain.yaml") == (Spread(), ())
    assert "spread" in trial_scenario_schema()["properties"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "storm.yaml: expected keys: schema, faults, spread"),
        ("{schema: 1, spread: {wnd: 1}}", "storm.yaml: spread: wnd: unknown key, got 1"),
        ("{schema: 1, faults: [{at: 1, kind: hail}]}", "storm.yaml: faults.0.kind"),
        ("{schema: 1, spread: {failures: [hail]}}", "storm.yaml: spread: failures.0"),
    ],
)
def test_errors_of_a_scenario_name_their_place(text, message):
    with pytest.raises(InputError) as caught:
        read_scenario(text, "storm.yaml")
    assert message in str(caught.value)


@pytest.mark.slow
def test_only_the_emulator_flies_a_refused_plan(tmp_path):
    wrong = uncleared("clearance.vehicle=3.5")
    errors = [found for found in wrong.assessment.findings if found.severity == "error"]
    assert errors
    with pytest.raises(Refused, match="vehicle clearance: "):
        CertifiedPlan(wrong.plan, wrong.certificate)
    fleet = emulated_fleet(3)
    with pytest.raises(Refused, match="a comparison is flown by swarm dry-run only"):
        fly(wrong, fleet, tmp_path / "record")
    assert not (tmp_path / "record").exists()
    flown, result = fly_trial(wrong, CALM, 1, 0, options=FlightOptions(open_loop=True))
    assert flown.outcome == "done"
    assert result.basis.kind == "comparison"
    assert result.basis.checked == "not certified: flown for comparison"
    assert result.exit_code == 3
    assert "no error was certified" in result.adherence.words


def test_results_are_one_row_per_trial(tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "trials.parquet"
    write_results(path, [(PLAN, [trial(1, distances={"cable": None}), trial(0)])], 9, CALM)
    table = pq.read_table(path)
    assert table["number"].to_pylist() == [0, 1]
    assert table["seed"].to_pylist() == [9, 9]
    assert table["cable"].to_pylist() == [0.5, None]
    assert json.loads(table.schema.metadata[b"spread"])["wind"] == 0.0
    with pytest.raises(InputError, match="no such file"):
        write_results(tmp_path / "none" / "a.parquet", [(PLAN, [trial()])], 1, CALM)


def test_the_terminal_shows_completion_distances_and_the_worst_trials():
    trials = [trial(0), trial(1, failure="vehicle 2: link", outcome="failed", reason="lost")]
    certified = certify_clearances(PLAN, trials, 1)
    document = summary(PLAN, trials, seed=7, spread=CALM, certified=certified)
    console = Console(file=io.StringIO(), width=200)
    print_trials(document, console, ["a mission.yaml"])
    lines = console.file.getvalue().splitlines()
    assert "2 trials of this plan, seed 7" in lines
    assert "not completed: 1 × lost" in lines
    assert any(line.startswith("cable to cable") for line in lines)
    assert any(line.startswith("among the worst: trial 1 (cable") for line in lines)
    assert lines[-1] == (
        "to repeat the worst: swarm dry-run 'a mission.yaml' --seed 7 --trial 1 "
        "--recording trial.rrd"
    )


def test_the_terminal_says_nothing_of_a_cable_or_an_interval_that_is_not_known():
    trials = [
        trial(k, distances=dict.fromkeys(("cable", "vehicle_cable", "emulated_cable")))
        for k in range(3)
    ]
    certified = certify_clearances(PLAN, trials, 1)
    document = summary(PLAN, trials, seed=7, spread=CALM, certified=certified)
    console = Console(file=io.StringIO(), width=80)
    print_trials(document, console, ["a mission.yaml"])
    lines = [line.rstrip() for line in console.file.getvalue().splitlines()]
    (distances,) = [line for line in lines if line.startswith("vehicle to vehicle")]
    assert distances.split("  ")[-1].strip() == "2.00 m"
    assert "among the worst: trial 0" in lines
    assert not any("?" in line or "unknown" in line for line in lines)
