"""What is made ready for the tests, and their order, where several processes run all of them."""

import importlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import hypothesis
import pytest

from swarm import precompile
from tests.shared import FOLDER

# Before NumPy is imported: one thread for sums of arrays, as the goldens were made. Several processes
# share the cores anyway.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

# Where the system says to keep no bytecode, each of two hundred processes would make that of three
# hundred modules for itself, and each process of pytest-xdist that of the tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A test plans for itself: no plan of the user, or of another test, is read.
os.environ["SWARM_PLANS"] = ""

# How long an example takes says nothing of what it tests: machines are shared, and the first one
# may compile.
hypothesis.settings.register_profile("patient", deadline=None)
hypothesis.settings.load_profile("patient")

LONGEST = (
    "test_house_rule[mypy]",
    "test_two_browsers_command_a_flight",
    "test_the_overhand_flies_over_udp_and_leaves_its_record",
    "test_the_walk_through_runs_and_prints_its_output",
    "test_the_command_guides_and_records",
    "test_the_lines_at_the_top_run_with_a_small_mission",
    "test_a_closed_terminal_and_another_that_attaches",
    "test_after_sigkill_in_the_fold_the_team_is_found",
    "test_a_drawn_failure_of_each_kind",
    "test_trials_in_processes_are_the_trials_flown_alone",
    "test_parameters_are_checked_set_and_restored",
    "test_viewers_that_come_late_see_the_flight",
    "test_a_flight_stays_safe_and_ends_whatever_happens",
    "test_a_killed_emulator_is_explained",
    "test_a_training_flight_from_command_to_report",
    "test_the_tour_plans_certifies_draws_and_rehearses",
    "test_a_check_says_what_each_vehicle_gets",
    "test_a_slow_caller_does_not_delay_the_flight",
    "test_a_closed_pipe_ends_the_screen_and_not_the_flight",
)
"""Parts of the names of tests that take ten seconds and more, longest first."""


@pytest.fixture(scope="module")
def in_real_time() -> Iterator[None]:
    """Put flights over real links ahead of the other tests, where the system permits it.

    Where the world does not wait for its ground station, autopilots leave offboard after half a
    second without setpoint, of its time. Programs that a test begins inherit what it has of the
    processor.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, before - 10)
    yield
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, before)


def pytest_configure(config: pytest.Config) -> None:
    """Compile and plan once what each process of pytest-xdist would otherwise make for itself."""
    if not hasattr(config, "workerinput"):
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="swarm-tests-")
        os.environ["XDG_STATE_HOME"] = os.environ[FOLDER]
    in_processes = config.getoption("numprocesses", None) and not config.option.collectonly
    if in_processes and config.args == config.getini("testpaths"):
        precompile.prepare((*precompile.PLANNING, *precompile.FLIGHT, *precompile.SEARCH))


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove what the processes shared."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ.pop(FOLDER), ignore_errors=True)


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Import the tests, in each process from another one on: it compiles them for the others.

    All processes need all tests, and what pytest makes of their assertions takes seconds to compile.
    """
    config = session.config
    given: dict[str, object] = getattr(config, "workerinput", {})
    if not given or config.args != config.getini("testpaths"):
        return
    here = Path(__file__).parent
    paths = sorted(here.rglob("test_*.py"))
    begin = (
        len(paths)
        * int(str(given["workerid"]).removeprefix("gw"))
        // int(str(given["workercount"]))
    )
    for path in paths[begin:] + paths[:begin]:
        # Whatever fails is imported again, and reported, by the collection.
        with suppress(Exception, pytest.skip.Exception):
            importlib.import_module(".".join(path.relative_to(here.parent).with_suffix("").parts))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with what takes longest, in different processes, so that none of it ends the run alone.

    Every process of pytest-xdist's ``worksteal`` is given an equal run of the tests to begin with.
    """
    workers: int = getattr(config, "workerinput", {}).get("workercount", 1)
    first = [item for name in LONGEST for item in items if name in item.nodeid]
    rest = [item for item in items if item not in first]
    total = len(items)
    items.clear()
    for worker in range(workers):
        size = (total - len(items)) // (workers - worker)
        begin = first[worker::workers][:size]
        items += begin + rest[: size - len(begin)]
        del rest[: size - len(begin)]
