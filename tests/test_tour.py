"""The scripts in missions/ run as they stand."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

MISSIONS = Path(__file__).parents[1] / "missions"


@pytest.mark.slow
def test_the_tour_plans_certifies_draws_and_rehearses(tmp_path):
    mission = MISSIONS / "first-steps" / "two_carry.yaml"
    done = subprocess.run(
        [sys.executable, MISSIONS / "tour.py", mission, tmp_path],
        check=True, capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert "2 vehicles" in done.stdout
    assert "<Certificate: cleared for 0.1 m, e* " in done.stdout
    assert "<Flight two-carry: done, " in done.stdout
    assert done.stderr == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "flight.png", "mission.plan", "motion.csv", "plan.png", "schedule.png",
    ]  # fmt: skip


@pytest.mark.parametrize("program", sorted(MISSIONS.glob("*.py")), ids=lambda path: path.name)
def test_every_program_finds_what_it_imports(program):
    runpy.run_path(str(program))
