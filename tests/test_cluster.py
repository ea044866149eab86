"""Work on a Dask cluster: the file in missions/, knots and failure tests on its workers."""

import inspect
import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from joblib.externals.loky import process_executor

from swarm.errors import SwarmError
from swarm.simulation.failure_cases import FAILURE_CASES
from swarm.simulation.failure_tests import FailureTestSettings, run_failure_tests
from swarm.simulation.workers import parallel_workers
from tests.command import run
from tests.network import small_plan

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def scheduler():
    cluster = subprocess.Popen(
        [sys.executable, str(ROOT / "missions" / "cluster.py"), "--port", "0", "--workers", "1"],
        stdout=subprocess.PIPE, text=True, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert cluster.stdout is not None
    yield cluster.stdout.readline().strip()
    cluster.send_signal(signal.SIGINT)
    assert cluster.wait(60) == 0
    cluster.stdout.close()


@pytest.mark.full
def test_knots_are_planned_on_the_workers(scheduler):
    said = run(
        "knots",
        "--plan",
        "--filter",
        "^3_1$",
        "--no-robustness",
        "--scheduler",
        scheduler,
        "--json",
    )
    assert said.returncode == 0, said.stderr
    (row,) = json.loads(said.stdout)
    assert (row["knot"], row["vehicles"], row["cleared"]) == ("3_1", 9, True)


@pytest.mark.slow
def test_failure_tests_on_the_workers_are_those_of_this_machine(scheduler):
    plan = small_plan(vehicles=3)
    cases = [case for case in FAILURE_CASES if case.name == "killed"]
    settings = FailureTestSettings(cases, ["ardupilot"], times=1, seed=3)
    alone = run_failure_tests(plan, settings, jobs=1)
    assert run_failure_tests(plan, settings, scheduler=scheduler) == alone


def test_a_scheduler_that_does_not_answer_is_an_error():
    with (
        pytest.raises(SwarmError, match="no Dask scheduler at tcq://nowhere:1"),
        parallel_workers(None, "tcq://nowhere:1"),
    ):
        pass
    said = run("knots", "--plan", "--filter", "^3_1$", "--scheduler", "tcq://nowhere:1")
    assert (said.returncode, said.stdout) == (1, "")
    assert "no Dask scheduler at tcq://nowhere:1: " in said.stderr


def test_a_worker_that_is_replaced_because_its_memory_grew_is_no_warning_of_the_command():
    about = "A worker stopped while some jobs were given to the "
    assert f'"{about}"' in inspect.getsource(process_executor)
    with parallel_workers(1, None):
        warnings.warn(f"{about}executor.", UserWarning, stacklevel=1)
    with pytest.raises(UserWarning, match=about):
        warnings.warn(f"{about}executor.", UserWarning, stacklevel=1)
