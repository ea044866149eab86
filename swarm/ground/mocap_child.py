"""A laboratory's motion capture in a process of its own, run as ``python -m``.

The only module that imports libmotioncapture. Its Python package keeps the interpreter locked while
it connects and while it waits for a frame: within the ground station, a silent system would stop
the setpoints of all vehicles. Poses are sent over the pipe whose descriptor is the first argument;
:mod:`swarm.ground.mocap` is the other side.
"""

import math
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping
from multiprocessing.connection import Connection
from typing import Any

from swarm.ground.child_process import die_with_parent

_SHORTEST = 0.002
"""Seconds between frames that are passed on: some systems answer at once, with the same poses."""

Body = tuple[int, float, tuple[float, float, float], tuple[float, float, float, float]]
"""System id, seconds, metres (ENU), quaternion w, x, y, z."""


def named_bodies(bodies: Mapping[str, Any], moment: float) -> Iterator[Body]:
    """Yield the rigid bodies whose names end in a number, and that are seen."""
    for name, body in bodies.items():
        number = re.search(r"\d+$", name)
        x, y, z = (float(value) for value in body.position)
        if number is not None and all(map(math.isfinite, (x, y, z))):
            q = body.rotation
            yield int(number[0]), moment, (x, y, z), (q.w, q.x, q.y, q.z)


def _send_frames(kind: str, host: str, pipe: Connection) -> None:
    import motioncapture  # type: ignore[import-not-found]  # noqa: PLC0415 - an optional extra

    system = motioncapture.connect(kind, {"hostname": host})
    pipe.send(("connected",))
    while True:
        system.waitForNextFrame()
        bodies = list(named_bodies(system.rigidBodies, time.monotonic()))
        if bodies:
            pipe.send(("frame", bodies))
        time.sleep(_SHORTEST)


def main() -> None:
    """Connect to the system in the first message, and send its frames."""
    die_with_parent()
    with Connection(int(sys.argv[1])) as pipe:
        try:
            kind, host = pipe.recv()
            _send_frames(kind, host, pipe)
        except (BrokenPipeError, EOFError):
            pass
        except Exception as error:
            pipe.send(("failed", str(error) or type(error).__name__))
    # do not wait for the library: its threads have aborted at their end
    os._exit(0)


if __name__ == "__main__":
    main()
