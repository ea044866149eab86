"""Machine code for the tests, compiled once before several processes each compile all of it.

Everything that is compiled when it is first called is kept in the user's cache, so that this is
done when a source of it has changed and on a new machine, where it takes half a minute on two
cores and spares the tests more than twice of that.
"""

import hashlib
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
_HALVES = ("plan", "fly")
"""What is run, at the same time: each takes about as long as the other."""


def prepare() -> None:
    """Compile what most tests call, unless that has been done for these very sources."""
    done = _mark()
    if done.exists():
        return
    print("compiling for these tests what has not been compiled yet", flush=True)
    halves = [
        subprocess.Popen([sys.executable, "-m", __name__, half], cwd=ROOT) for half in _HALVES
    ]
    codes = [half.wait() for half in halves]
    if not any(codes) and done.parent.is_dir():
        done.touch()


def _mark() -> Path:
    """The file that says that it has been done, in the folder of `swarm.jit`."""
    from swarm.jit import cache, key

    sources = [path for name in ("swarm", "sitl") for path in sorted((ROOT / name).rglob("*.py"))]
    compiled = [path for path in sources if b"@compiled" in path.read_bytes()]
    keys = [str(ROOT), *(key(str(path)) for path in compiled)]
    return cache() / f"tests-{hashlib.sha256(repr(keys).encode()).hexdigest()[:16]}"


def _plan() -> None:
    from swarm.mission import mission_for_knot
    from swarm.planning import make_plan

    make_plan(mission_for_knot("overhand"))


def _fly() -> None:
    from sitl.warm import warm_up
    from swarm.certification.assess import assess
    from swarm.simulation.loop import simulate_flight
    from tests.certification.conftest import recorded_overhand
    from tests.network import small_plan

    warm_up()
    simulate_flight(small_plan())
    assess(recorded_overhand())


if __name__ == "__main__":
    {"plan": _plan, "fly": _fly}[sys.argv[1]]()
