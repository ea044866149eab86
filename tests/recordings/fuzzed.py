"""What an autopilot in flight does with random packets: how many it takes, and what it does then.

``python -m tests.recordings.fuzzed KIND COUNT OUT.jsonl [--firmware PATH] [--valid] [--seed N]``

One vehicle with the parameters of the ground station's audit hovers at 4 m, as in :mod:`.alone`.
Then packets from a foreign system id come in, RATE in a second of the world, and the ground station
goes on as before. They are spoiled frames of all messages, none of them valid: truncated, with
flipped bits or wrong checksums, or noise. With ``--valid`` every other one is a valid frame of any message but
commands, with random values. Without ``--firmware`` the emulated autopilot flies.
"""

import argparse
import itertools
import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sitl.physics.dynamics import STEP
from sitl.world import Kind
from tests.recordings.alone import BEFORE, MODE_AT, Watch, flown, one_vehicle
from tests.sitl.random_packets import COMMANDS, messages, spoil

RATE = 2000
"""Packets in a second of the world; a link of 1 Mbit/s carries about as many."""

FLOATS = {"SIM_FLOAT_EXCEPT": 0.0}
"""ArduPilot's simulator ends at the first floating point exception; boards do not trap them."""


def packets(rng: random.Random, *, valid: bool) -> Iterator[bytes]:
    """Yield packets without an end."""
    frames = [frame for frame in messages(rng) if frame[7:10] not in COMMANDS]
    for number in itertools.count():
        frame = packet = rng.choice(frames)
        while frame in packet and not (valid and number % 2):
            packet = spoil(frame, rng)
        yield packet


def fuzz(kind: Kind, count: int, program: Path | None, *, valid: bool, seed: int) -> dict[str, Any]:
    """Fly one vehicle through ``count`` packets; return what was seen.

    The flight ends early where the autopilot is on the ground for ten seconds.
    """
    source = packets(random.Random(seed), valid=valid)
    values = FLOATS if kind == "ardupilot" and program else {}
    with one_vehicle(kind, program, radio=False, values=values) as (one, step):
        seen, sent, each = Watch(one), 0, round(RATE * STEP)
        for now in flown(one, step, seen):
            if now < MODE_AT[kind] + BEFORE:
                continue
            if not sent:
                seen.begin(now)
            seen.watch(now)
            for packet in itertools.islice(source, min(each, count - sent)):
                one.stranger(packet)
            sent = min(sent + each, count)
            if sent == count or (seen.down is not None and now > seen.at + seen.down + 10.0):
                break
        return {
            "row": "valid packets" if valid else "spoiled packets", "kind": kind,
            "real": one.real, "packets": sent, "seconds": round(now - seen.at, 1),
            "processes": len(one.processes()), **seen.result(),
        }  # fmt: skip


def main() -> None:
    """Fuzz one autopilot; add a line of JSON to the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=["px4", "ardupilot"])
    parser.add_argument("count", type=int)
    parser.add_argument("out", type=Path)
    parser.add_argument("--firmware", type=Path)
    parser.add_argument("--valid", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    found = fuzz(given.kind, given.count, given.firmware, valid=given.valid, seed=given.seed)
    with given.out.open("a") as file:
        file.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
