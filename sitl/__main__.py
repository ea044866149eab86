"""Command line of the emulator: ``python -m sitl``."""

import json
import os
import sys
import time
from pathlib import Path
from typing import get_args

import click

from sitl import server
from sitl.emulator import Emulator
from sitl.faults import load_scenario
from sitl.firmware.processes import (
    Firmware,
    FirmwareError,
    Positioning,
    assign,
    check_positioning,
    parse_firmware,
)  # fmt: skip
from sitl.firmware.team import flying
from sitl.world import Kind, WorldError, default_world, load_key, load_world, schema
from swarm import precompile
from swarm.jit import sealed

FILE = click.Path(dir_okay=False, path_type=Path)


def _kinds(_context: click.Context, _parameter: click.Parameter, value: str) -> list[Kind]:
    """Return the autopilots of a list separated by commas."""
    known = {kind: kind for kind in get_args(Kind)}
    try:
        return [known[kind] for kind in value.split(",")]
    except KeyError:
        raise click.BadParameter(f"expected px4 or ardupilot, got {value}") from None


def _finite_speed(_context: click.Context, _parameter: click.Parameter, value: float) -> float:
    """Return the speed; a range of Click would take NaN."""
    if not 0.01 <= value <= 1000.0:
        raise click.BadParameter(f"expected 0.01 to 1000, got {value}")
    return value


def _address(
    _context: click.Context, _parameter: click.Parameter, value: str | None
) -> tuple[str, int] | None:
    """Return the host and the port of HOST:PORT."""
    if value is None:
        return None
    host, _, port = value.rpartition(":")
    if not port.isdigit() or not 0 < int(port) < 65536:
        raise click.BadParameter(f"expected HOST:PORT, got {value}")
    return host or "127.0.0.1", int(port)


@click.command(
    "sitl", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.option("--world", type=FILE, help="World file (YAML or JSON).")
@click.option(
    "-n", "--count", type=click.IntRange(1, 250), help="Number of vehicles, no cable [1]."
)
@click.option(
    "--autopilot",
    "kinds",
    default="px4",
    show_default=True,
    metavar="KIND[,KIND]",
    callback=_kinds,
    help="px4, ardupilot, or both separated by a comma, in turn; without --world.",
)
@click.option(
    "--firmware",
    metavar="KIND=PATH",
    help="Vehicles of this kind fly with real firmware: ardupilot=PATH of an ArduCopter built for "
    "SITL, px4=BUILD_FOLDER of a PX4, or 5*px4=…,4*ardupilot=… for some of them.",
)
@click.option(
    "--firmware-folder",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for the firmware's parameters and logs; without it they are deleted.",
)
@click.option(
    "--positioning",
    type=click.Choice(get_args(Positioning)),
    default="rtk",
    show_default=True,
    help="How real firmware knows its position: ArduPilot's simulated receiver, one with RTK, or "
    "motion capture, which a ground station must send (--mocap).",
)
@click.option(
    "--mocap",
    metavar="HOST:PORT",
    callback=_address,
    help="Send the vehicles' true poses there, as a motion capture system (JSON datagrams).",
)
@click.option("--scenario", type=FILE, help="Faults to inject (YAML).")
@click.option(
    "--speed",
    type=float,
    callback=_finite_speed,
    default=1.0,
    show_default=True,
    help="Multiple of real time.",
)
@click.option("--seed", type=int, help="Seed of all random values, instead of the world's.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to bind.")
@click.option(
    "--target", metavar="HOST:PORT", callback=_address, help="UDP address for all vehicles."
)
@click.option("--port-step", type=int, help="PX4: vehicle i sends to UDP 14540 + i·STEP.")
@click.option("--signing-key", type=FILE, help="Sign frames with this key, drop all others.")
@click.option("--truth", type=FILE, help="Write the ground truth (JSON lines).")
@click.option(
    "--clock",
    type=FILE,
    help="Keep the world's time in this file (two "
    "little-endian doubles: the world's time, and how far the ground station lets it go on).",
)
@click.option("--json", "as_json", is_flag=True, help="Print the connections as one JSON line.")
@click.option(
    "--follow-parent",
    is_flag=False,
    flag_value=0,
    type=int,
    metavar="PID",
    help="End when the parent process ends.",
)
@click.option("--schema", "print_schema", is_flag=True, help="Print the schema of world files.")
@click.pass_context
def command(
    context: click.Context,
    /,
    world: Path | None,
    count: int | None,
    kinds: list[Kind],
    firmware: str | None,
    firmware_folder: Path | None,
    positioning: Positioning,
    mocap: tuple[str, int] | None,
    scenario: Path | None,
    speed: float,
    seed: int | None,
    host: str,
    target: tuple[str, int] | None,
    port_step: int | None,
    signing_key: Path | None,
    truth: Path | None,
    clock: Path | None,
    as_json: bool,
    follow_parent: int | None,
    print_schema: bool,
) -> None:
    """Run emulated vehicles (PX4-like or ArduPilot-like), for any MAVLink client.

    They are attached to one cable if the world has one. Without --target they use the ports of
    the real simulators.

    Exit code 2 for a wrong option or file, 3 if the sockets cannot be opened.

    Example: swarm sitl -n 3 --autopilot ardupilot
    """
    if print_schema:
        click.echo(json.dumps(schema(), indent=2))
        return
    if world is not None and count is not None:
        raise click.UsageError("--world and --count do not go together")
    parent = os.getppid()
    try:
        parts = parse_firmware(firmware) if firmware else []
        check_positioning(parts, positioning)
        if parts:
            kinds = _in_order(parts, count or 1)
        made = load_world(world) if world else default_world(count or 1, kinds)
        if seed is not None:
            made = made.model_copy(update={"seed": seed})
        faults = load_scenario(scenario) if scenario else []
        flown = assign(parts, made)
        emulator = Emulator(made, faults, outside=list(flown))
        if signing_key:
            emulator.sign_with(load_key(signing_key), time.time())
    except (WorldError, FirmwareError) as error:
        click.echo(f"{error}", err=True)
        context.exit(2)
    precompile.load()
    try:
        running = (
            server.to_target(emulator, target, host, speed)
            if target
            else server.to_default_ports(emulator, host, speed, port_step)
        )
        if clock is not None:
            running.clock = server.open_clock(clock)
        if mocap is not None:
            running.capture = server.MotionCapture(emulator, mocap)
        address = f"{target[0]}:{target[1]}" if target else None
        with (
            sealed(),
            flying(emulator, flown, address, firmware_folder, positioning) as exchange,
        ):
            if exchange is not None:
                running.advance = exchange.advance
            # with its PID, a parent that ended before this process started is detected too
            followed = None if follow_parent is None else follow_parent or parent
            server.serve(running, truth, as_json=as_json, parent=followed)
    except FirmwareError as error:
        click.echo(f"{error}", err=True)
        context.exit(3)
    except OSError as error:
        click.echo(
            f"swarm sitl: cannot open sockets on {host}: {error.strerror or error}", err=True
        )
        context.exit(3)


def main(arguments: list[str] | None = None) -> int:
    """Run the emulator; return the exit code.

    0 success, 2 usage or file error, 3 sockets, 130 interrupt.
    """
    try:
        code = command.main(arguments, prog_name="swarm sitl", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return 2
    except click.Abort:
        return 130
    return code if isinstance(code, int) else 0


def _in_order(parts: list[Firmware], count: int) -> list[Kind]:
    """Return the autopilots of ``count`` vehicles, in the order of ``--firmware``."""
    kinds = [part.kind for part in parts for _ in range(part.count or 0)]
    return kinds + [parts[-1].kind] * (count - len(kinds))


if __name__ == "__main__":
    sys.exit(main())
