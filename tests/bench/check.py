"""How long ``swarm check`` takes on nine vehicles that carry as many parameters as real ones.

    python -m tests.bench.check px4|ardupilot [--parameters FILE] [--vehicles 9]

Emulated vehicles stand behind the ports of `missions/fleets/*_sitl.yaml`. Without FILE they carry
as many parameters as PX4 1.16 or ArduCopter 4.6 do, made up; FILE is what an earlier check saved of
a real vehicle. They send them at the pace of the real ones (PX4 1070 a second and vehicle,
ArduCopter 1680, measured). Timed: a check alone, one with --fix of all defaults, one after it.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import sitl.autopilots.services
from sitl import server
from sitl.emulator import AUTOPILOT_STEPS, Emulator
from sitl.physics.dynamics import STEP
from sitl.world import default_world
from swarm import precompile
from tests.command import run

NUMBER = {"px4": 886, "ardupilot": 1391}
PACE = {"px4": 1070.0, "ardupilot": 1680.0}
"""Parameters a second of one vehicle."""
_FLEETS = Path(__file__).parents[2] / "missions" / "fleets"


def carrying(kind: str, table: dict[str, float], vehicles: int) -> Emulator:
    """Return emulated vehicles with more parameters than they know the meaning of."""
    emulator = Emulator(default_world(vehicles, (kind,)))
    for vehicle in emulator.vehicles:
        known = vehicle.parameters
        more = {name: value for name, value in table.items() if name not in known.values}
        known.load({**known.values, **more}, dict(known.kinds))
    return emulator


def serve(kind: str, table: dict[str, float], vehicles: int, ready: object) -> None:
    """Run the emulator as a process."""
    sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115
    sitl.autopilots.services.PARAMETERS_PER_UPDATE = round(PACE[kind] * AUTOPILOT_STEPS * STEP)
    emulator = carrying(kind, table, vehicles)
    precompile.load()
    running = server.to_default_ports(emulator, "127.0.0.1", 1.0, None)
    ready.set()  # type: ignore[attr-defined]
    running.run(None, None)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=sorted(NUMBER))
    parser.add_argument("--parameters", type=Path)
    parser.add_argument("--vehicles", type=int, default=9)
    given = parser.parse_args()
    kind = given.kind
    table = {f"BENCH_{k:05d}": 0.5 * k for k in range(NUMBER[kind])}
    if given.parameters:
        table = json.loads(given.parameters.read_text())
    else:
        own = len(carrying(kind, {}, 1).vehicles[0].parameters.names)
        table = dict(list(table.items())[: NUMBER[kind] - own])
    ready = multiprocessing.get_context("spawn").Event()
    process = multiprocessing.get_context("spawn").Process(
        target=serve, args=(kind, table, given.vehicles, ready), daemon=True
    )
    process.start()
    ready.wait()
    run("plan", "3_1")  # compiled and planned once: that is not what is measured
    arguments = ["check", "3_1", "--fleet", str(_FLEETS / f"{kind}_sitl.yaml")]
    try:
        with TemporaryDirectory() as folder, mock.patch("sys.stdin", open(os.devnull)):
            for words, more in (("alone", []), ("--fix", ["--fix", "--yes"]), ("after", [])):
                began = time.monotonic()
                said = run(*arguments, *more, "--json", "--record", f"{folder}/{words}")
                took = time.monotonic() - began
                if said.returncode > 1:
                    sys.exit(said.stderr)
                found = json.loads(said.stdout)
                saved = json.loads(next(Path(folder, words, "parameters").iterdir()).read_text())
                print(
                    f"{kind} {words:<6} {took:6.1f} s  {len(found['vehicles'])} vehicles, "
                    f"{len(saved)} parameters each, {len(found['changed'])} set, "
                    f"{'GO' if found['go'] else 'NO-GO'}",
                    flush=True,
                )
    finally:
        process.kill()
        process.join()


if __name__ == "__main__":
    main()
