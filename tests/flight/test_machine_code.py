"""Nothing is compiled while vehicles fly, and nothing that a flight calls lacks machine code."""

import dis
import importlib
import os
import pkgutil
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import sitl
import swarm
from swarm import precompile
from swarm.jit import compiled, declared, sealed
from swarm.signatures import Columns2, Floats1, Floats2

ROOT = Path(__file__).parents[2]
ASIDE = ("swarm.cli", "swarm.view", "swarm.reports", "swarm.ground.commissioning.mavsdk_child")
"""Modules that call no compiled functions, and are slow to import or do not return."""


def modules() -> list[types.ModuleType]:
    names = [
        one.name
        for package in (swarm, sitl)
        for one in pkgutil.walk_packages(package.__path__, f"{package.__name__}.", onerror=print)
    ]
    wanted = [name for name in names if not name.startswith(ASIDE) and "__main__" not in name]
    return [importlib.import_module(name) for name in wanted]


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from codes(inner)


def python_functions(module: types.ModuleType) -> Iterator[types.FunctionType]:
    for value in vars(module).values():
        for one in vars(value).values() if isinstance(value, type) else (value,):
            function = getattr(one, "fget", getattr(one, "func", getattr(one, "__func__", one)))
            if not isinstance(function, Dispatcher):  # as by functools.cache
                function = getattr(function, "__wrapped__", function)
            if isinstance(function, types.FunctionType) and function.__module__ == module.__name__:
                yield function


def called(function: types.FunctionType) -> Iterator[Dispatcher]:
    """The compiled functions that a Python function names, itself or through a module."""
    known = function.__globals__
    for code in codes(function.__code__):
        owner: object = None
        for step in dis.get_instructions(code):
            value = getattr(owner, str(step.argval), None)
            if step.opname == "LOAD_GLOBAL":
                value = known.get(step.argval)
            if isinstance(value, Dispatcher):
                yield value
            owner = value if isinstance(value, types.ModuleType) else None


def test_whatever_python_calls_declares_its_types():
    undeclared = {
        f"{one.py_func.__module__}.{one.py_func.__name__}, called by {module.__name__}"
        for module in modules()
        for function in python_functions(module)
        for one in called(function)
        if declared(one) is None
    }
    assert undeclared == set()


def test_what_only_compiled_functions_call_is_inner():
    """Anything else is compiled beforehand as Python would call it, which takes longer."""
    used = {
        one for module in modules() for code in python_functions(module) for one in called(code)
    }
    unused = {
        f"{one.py_func.__module__}.{one.py_func.__name__}"
        for module in modules()
        for one in vars(module).values()
        if isinstance(one, Dispatcher) and declared(one) is not None and one not in used
    }
    assert unused == set()


def test_every_compiled_function_is_in_a_package_that_is_compiled_beforehand():
    rare = (*precompile.SEARCH, *precompile.OPTIMISATION)
    named = (*precompile.PLANNING, *precompile.FLIGHT, *rare)
    found = {
        one.py_func.__module__
        for module in modules()
        for one in vars(module).values()
        if isinstance(one, Dispatcher)
    }
    assert {name for name in found if not name.startswith(named)} == set()


FLY = """
import sys
from numba.core.dispatcher import Dispatcher
from swarm import precompile
from swarm.jit import sealed
from swarm.mission.fleet import emulated_fleet
from tests.network import Network, small_plan

def machine_code():
    return {
        f"{name}.{key}": len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith(("swarm", "sitl"))
        for key, value in vars(module).items() if isinstance(value, Dispatcher)
    }

flight = Network(small_plan(), emulated_fleet(3, ("px4", "ardupilot"), cable=sys.argv[2]))
assert precompile.load() > 50
modules, before = set(sys.modules), machine_code()
with sealed():
    flight.until_phase("fold", 3.0)
    if sys.argv[1] == "leave":
        flight.conductor.request("release")
    result = flight.run()
assert result.word == ("interrupted" if sys.argv[1] == "leave" else "done"), result
assert machine_code() == before
late = {name for name in set(sys.modules) - modules if name.startswith(("swarm", "sitl"))}
assert not late, late
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        ("leave", "static"),
        pytest.param(("to the end", "static"), marks=pytest.mark.full),
        pytest.param(("leave", "swinging"), marks=pytest.mark.full),
    ],
)
def test_nothing_is_compiled_or_interpreted_in_flight(how):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", FLY, *how],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@compiled
def total(values: Floats1, factor: float) -> float:
    result = 0.0
    for value in values:
        result += factor * value
    return result


@compiled
def corner(values: Columns2) -> float:
    return float(values[0, -1])


@compiled
def _anything(values):  # type: ignore[no-untyped-def]
    return values[0]


def test_a_declared_function_has_machine_code_for_its_types_alone():
    assert declared(total) == (numba.float64[::1], numba.float64)
    assert total(np.arange(4.0), 2.0) == 12.0
    assert total(np.arange(4.0), 2) == 12.0
    # of one row, a part of an array has no gaps
    whole = np.arange(6.0).reshape(2, 3)
    assert (corner(whole[:, :2]), corner(whole[:1, :2]), corner(whole)) == (1.0, 1.0, 2.0)
    assert [len(one.signatures) for one in (total, corner)] == [1, 1]


def test_in_the_air_what_has_no_machine_code_is_interpreted_and_reported():
    with sealed():
        for values in (np.arange(8.0)[::2], np.arange(4)):
            with pytest.warns(RuntimeWarning, match=r"total is interpreted"):
                total(values, 1.0)
        with pytest.warns(RuntimeWarning, match=r"_anything is interpreted"):
            assert _anything(np.arange(1.0, 3.0)) == 1.0
    assert not _anything.signatures
    assert _anything(np.arange(1.0, 3.0)) == 1.0
    assert len(_anything.signatures) == 1


def test_types_that_annotations_do_not_tell_are_not_declared():
    assert declared(_anything) is None

    @compiled
    def several(points: Floats2, rest: tuple[float, list[float]]) -> float:
        return points[0, 0] + rest[0]

    assert declared(several) is None


SEARCH = """
from swarm import precompile
from swarm.knots import sticks
flown = precompile.load()
assert not sticks._reduce.signatures and not sticks._shape.signatures
assert precompile.load(precompile.imported()) == flown + 2
assert len(sticks._reduce.signatures) == len(sticks._shape.signatures) == 1
"""


def test_what_only_a_search_for_few_vehicles_calls_is_not_loaded_for_a_flight():
    done = subprocess.run(
        [sys.executable, "-c", SEARCH],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr


PREPARE = """
from swarm import precompile
from swarm.jit import cache
seen = []
packages = ("swarm.planning.timing", "swarm.geometry.distance")
precompile.prepare(packages, lambda stage, share: seen.append(share))
assert seen[-1] == 1.0 and seen == sorted(seen) and len(seen) > 3, seen
assert len(list(cache().glob("*/**/*.nbi"))) >= 3
precompile.prepare(packages, lambda stage, share: seen.append(2.0))
assert seen[-1] == 1.0
"""


def run_prepare(folder: Path, script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        env=os.environ | {"XDG_CACHE_HOME": str(folder)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_functions_are_compiled_beside_each_other_and_once(tmp_path):
    done = run_prepare(tmp_path, PREPARE)
    assert done.returncode == 0, done.stderr


def test_without_a_cache_nothing_is_compiled_beforehand(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = run_prepare(
        tmp_path / "file",
        "from swarm.precompile import prepare, FLIGHT\nprepare(FLIGHT, lambda *_: 1 / 0)",
    )
    assert done.returncode == 0, done.stderr
