"""``swarm certify`` on motions that are broken on purpose: each is refused for the right reason."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from swarm.cli.certify import certify
from swarm.exports import motion_rows
from swarm.mission import mission_for_knot
from swarm.planning import Plan
from swarm.planning.candidates import make_plan
from tests.certification.conftest import recorded_overhand

STEP = 0.5
"""Seconds between rows; the recorded plan has breakpoints every second."""

Rows = np.ndarray
"""Times, vehicles and states of a motion file: (k, n, 9) positions, velocities, accelerations."""


def certified(
    tmp_path: Path, plan: Plan, change: Callable[[Rows, Rows], Rows] | None = None, *keys: str
):
    """Errors by check, and the knot, of a plan's export after a change."""
    lines = list(motion_rows(plan, STEP))
    table = [line.split(",") for line in lines[1:]]
    count = plan.vehicles
    times = np.array([float(row[0]) for row in table[::count]])
    states = np.array([row[2:11] for row in table], dtype=float).reshape(-1, count, 9)
    if change is not None:
        states = change(times, states.copy())
    rows = [
        ",".join([row[0], row[1], *(f"{value:.9f}" for value in state), row[11]])
        for row, state in zip(table, states.reshape(-1, 9), strict=True)
    ]
    motion, cable = tmp_path / "motion.csv", tmp_path / "cable.json"
    motion.write_text("\n".join([lines[0], *rows]) + "\n")
    cable.write_text(json.dumps(plan.layout.lengths.tolist()))
    arguments = [str(motion), "--cable", str(cable), "--json", *keys]
    result = CliRunner().invoke(certify, arguments, catch_exceptions=False)
    found = json.loads(result.stdout)
    assert result.exit_code == (0 if found["cleared"] else 1)
    errors: dict[str, str] = {}
    for finding in found["findings"]:
        if finding["severity"] == "error":
            errors.setdefault(finding["check"], finding["message"])
    return errors, found["knot"]


def test_the_papers_trajectory_entangles_its_cable(tmp_path: Path) -> None:
    paper = make_plan(mission_for_knot("overhand", ["fold.method=paper", "layout.cell=3.0"]))
    errors, _ = certified(tmp_path, paper, None, "--set", "vehicles.tracking=0.0")
    assert "strands meet" in errors
    assert "the cable would entangle" in errors["strands meet"]


def test_a_vehicle_that_is_late_by_a_second_is_identified(tmp_path: Path) -> None:
    plan = recorded_overhand()
    fold = plan.phase("fold")

    def late(times: Rows, states: Rows) -> Rows:
        begins, ends = fold.start, fold.end
        moved = np.where(times < begins, times, np.clip(times - 1.0, begins, ends))
        moved = np.where(times > ends + 1.0, times, moved)
        states[:, 5] = np.concatenate(plan.motion.at(moved), axis=-1)[:, 5]
        return states

    errors, _ = certified(tmp_path, plan, late)
    assert "taut" in errors
    assert re.search(r"length of segment [56] ", errors["taut"])


@pytest.mark.full
def test_a_mirrored_motion_ties_the_mirrored_knot(tmp_path: Path) -> None:
    def mirror(_: Rows, states: Rows) -> Rows:
        states[:, :, 1::3] *= -1.0
        return states

    errors, knot = certified(tmp_path, recorded_overhand(), mirror)
    assert errors == {}, "the file requires no chirality"
    assert (knot["type"], knot["chirality"]) == ("3_1", "left")


@pytest.mark.full
def test_a_motion_that_jumps_or_is_too_fast_is_refused(tmp_path: Path) -> None:
    plan = recorded_overhand()

    def jump(times: Rows, states: Rows) -> Rows:
        states[times > plan.phase("fold").end, 2, 0] += 1.5
        return states

    errors, _ = certified(tmp_path, plan, jump)
    assert {"speed", "acceleration"} <= set(errors)
    assert "vehicle 3" in errors["speed"]
