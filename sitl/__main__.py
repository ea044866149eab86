"""Command line of the emulator: ``python -m sitl``."""

import argparse
import json
import os
import sys
import time
from pathlib import Path

from sitl import server
from sitl.emulator import Emulator
from sitl.faults.scenario import load_scenario
from sitl.warm import warm_up
from sitl.world import WorldError, default_world, load_key, load_world, schema


def argument_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; the reference pages are generated from it."""
    parser = argparse.ArgumentParser(
        prog="swarm sitl",
        description="Run emulated vehicles (PX4-like or ArduPilot-like), attached to one cable if "
        "the world has one. Without --target they use the ports of the real simulators.",
    )
    world = parser.add_mutually_exclusive_group()
    world.add_argument("--world", type=Path, metavar="FILE", help="world file (YAML or JSON)")
    world.add_argument("-n", "--count", type=int, default=1, help="number of vehicles, no cable")
    parser.add_argument(
        "--autopilot",
        default="px4",
        help="px4, ardupilot, or both separated by a comma, in turn (with -n)",
    )
    parser.add_argument("--scenario", type=Path, metavar="FILE", help="faults to inject (YAML)")
    parser.add_argument("--speed", type=float, default=1.0, help="factor of real time")
    parser.add_argument("--seed", type=int, help="seed, instead of the world's")
    parser.add_argument("--host", default="127.0.0.1", help="address to bind (loopback)")
    parser.add_argument("--target", metavar="HOST:PORT", help="UDP address for all vehicles")
    parser.add_argument("--port-step", type=int, help="PX4: vehicle i sends to UDP 14540 + i·STEP")
    parser.add_argument(
        "--signing-key",
        type=Path,
        metavar="FILE",
        help="sign frames with this key, drop all others",
    )
    parser.add_argument("--truth", type=Path, metavar="FILE", help="write ground truth, JSON lines")
    parser.add_argument("--json", action="store_true", help="print connections as one JSON line")
    parser.add_argument(
        "--follow-parent",
        nargs="?",
        type=int,
        const=0,
        metavar="PID",
        help="end when the parent process ends",
    )
    parser.add_argument("--schema", action="store_true", help="print the schema of world files")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the emulator; return the exit code (0 success, 2 usage or file error, 3 sockets)."""
    parent = os.getppid()
    parser = argument_parser()
    given = parser.parse_args(arguments)
    if given.schema:
        sys.stdout.write(json.dumps(schema(), indent=2) + "\n")
        return 0
    kinds = given.autopilot.split(",")
    if any(kind not in {"px4", "ardupilot"} for kind in kinds):
        parser.error(f"--autopilot: expected px4 or ardupilot, got {given.autopilot}")
    if not 1 <= given.count <= 250:
        parser.error(f"-n: expected 1 to 250, got {given.count}")
    if not 0.01 <= given.speed <= 1000.0:
        parser.error(f"--speed: expected 0.01 to 1000, got {given.speed}")
    target = None
    if given.target:
        host, _, port = given.target.rpartition(":")
        if not port.isdigit() or not 0 < int(port) < 65536:
            parser.error(f"--target: expected HOST:PORT, got {given.target}")
        target = (host or "127.0.0.1", int(port))
    try:
        world = load_world(given.world) if given.world else default_world(given.count, kinds)
        if given.seed is not None:
            world = world.model_copy(update={"seed": given.seed})
        faults = load_scenario(given.scenario) if given.scenario else []
        emulator = Emulator(world, faults)
        if given.signing_key:
            emulator.sign_with(load_key(given.signing_key), time.time())
    except WorldError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    warm_up()
    try:
        if target is not None:
            running = server.to_target(emulator, target, given.host, given.speed)
        else:
            running = server.to_default_ports(emulator, given.host, given.speed, given.port_step)
        return server.serve(
            running,
            given.truth,
            as_json=given.json,
            follow_parent=given.follow_parent is not None,
            # with its PID, a parent that ended before this process started is detected too
            parent=given.follow_parent or parent,
        )
    except OSError as error:
        sys.stderr.write(
            f"swarm sitl: cannot open sockets on {given.host}: {error.strerror or error}\n"
        )
        return 3


if __name__ == "__main__":
    sys.exit(main())
