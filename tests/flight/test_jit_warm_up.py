"""No function is compiled while vehicles fly: that would delay setpoints by seconds."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FLY = """
import sys
from numba.core.dispatcher import Dispatcher
import sitl.warm
from swarm.mission.fleet import emulated_fleet
from swarm.flight.jit_warm_up import warm_up
from tests.network import Network, small_plan

def compiled():
    return {
        f"{name}.{key}": len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith(("swarm", "sitl"))
        for key, value in vars(module).items() if isinstance(value, Dispatcher)
    }

flight = Network(small_plan(), emulated_fleet(3, ("px4", "ardupilot")))
conductor = flight.conductor
if "cold" not in sys.argv:
    sitl.warm.warm_up()
    warm_up(conductor)
assert conductor.stage == "prepare" and not conductor.events() and not len(conductor.trace().time)
before = compiled()
flight.until_phase("fold", 3.0)
if "leave" in sys.argv:
    conductor.request("release")
assert flight.run().word == ("interrupted" if "leave" in sys.argv else "done")
print(*[name for name, count in compiled().items() if count != before.get(name, 0)])
"""


def compiled_in_flight(*how: str) -> list[str]:
    """What a process of its own, that knows nothing compiled yet, compiles after take-off."""
    done = subprocess.run(
        [sys.executable, "-c", FLY, *how],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("how", ["leave", pytest.param("to the end", marks=pytest.mark.full)])
def test_nothing_is_compiled_in_flight(how):
    assert compiled_in_flight(how) == []


CALLED = """
import dis, sys, types
from numba.core.dispatcher import Dispatcher
import sitl.warm
from swarm.mission.fleet import emulated_fleet
from swarm.flight.jit_warm_up import warm_up
from tests.network import Network, small_plan

def codes(code):
    yield code
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from codes(inner)

def functions(module):
    for value in vars(module).values():
        within = vars(value).values() if isinstance(value, type) else (value,)
        for one in within:
            one = getattr(one, "fget", getattr(one, "func", getattr(one, "__func__", one)))
            if isinstance(one, types.FunctionType) and one.__module__ == module.__name__:
                yield one

flight = Network(small_plan(), emulated_fleet(3, ("px4", "ardupilot")))
sitl.warm.warm_up()
warm_up(flight.conductor)
for name, module in list(sys.modules.items()):
    if name.startswith(("swarm.flight", "swarm.mavlink", "sitl")):
        for function in functions(module):
            for code in codes(function.__code__):
                for step in dis.get_instructions(code):
                    if step.opname != "LOAD_GLOBAL":
                        continue
                    value = function.__globals__.get(step.argval)
                    if isinstance(value, Dispatcher) and not value.signatures:
                        print(f"{value.py_func.__module__}.{step.argval}")
"""


def test_all_that_a_flight_calls_is_compiled_before_it():
    done = subprocess.run(
        [sys.executable, "-c", CALLED], cwd=ROOT, capture_output=True, text=True, timeout=120,
        check=True,
    )  # fmt: skip
    # The last one turns states frame by frame, for tests; a flight turns them all in one loop.
    assert set(done.stdout.split()) <= {"swarm.mavlink.frames._to_vehicles"}


@pytest.mark.full
def test_without_going_through_it_before_something_would_be():
    assert "swarm.flight.estimation.setpoints_ned" in compiled_in_flight("cold")
