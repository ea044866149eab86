"""``swarm mocap``: the bridge of motion capture; which body is on which vehicle."""

import json
import queue
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import click
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from swarm.cli.inputs import FILE, FOLDER, Address, print_json
from swarm.errors import InputError, Interrupted
from swarm.flight.bodies import PoseRow
from swarm.front.files import load_fleet
from swarm.ground.commissioning.identify import identification_object
from swarm.ground.commissioning.identify import identify as identify_bodies
from swarm.ground.mocap import parse_url
from swarm.ground.mocap_bridge import BridgeState, serve
from swarm.ground.record import new_check_folder
from swarm.mission.fleet import Fleet
from swarm.reports.mocap import bridge_object, bridge_words, poses_table
from swarm.reports.result import SEVERITIES, STYLES, drawn

_LINES = 200
"""Lines that may wait for a terminal that stands still; then they are dropped."""
_JSON_EVERY = 2
"""States (two a second) for each line of JSON."""


@dataclass
class Screen:
    """Shows a bridge in a thread of its own: a terminal that stands still must not stop poses.

    On a terminal a table, in a pipe what happens; with ``as_json`` a line of JSON each second.
    """

    console: Console
    as_json: bool
    _waiting: "queue.Queue[BridgeState | str | None]" = field(
        default_factory=lambda: queue.Queue(_LINES)
    )
    _wrong: dict[int, bool] = field(default_factory=dict)
    _count: int = 0

    def show(self, state: BridgeState) -> None:
        """Show a state, if the terminal follows."""
        if self._waiting.qsize() < _JSON_EVERY:
            self._put(state)

    def say(self, words: str) -> None:
        """Show what has happened."""
        self._put(words)

    def _put(self, item: BridgeState | str | None) -> None:
        with suppress(queue.Full):
            self._waiting.put_nowait(item)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Show what comes until the block ends."""
        worker = threading.Thread(target=self._work, name="screen", daemon=True)
        worker.start()
        try:
            yield
        finally:
            self._put(None)
            worker.join(1.0)

    def _work(self) -> None:
        # a closed terminal or pipe: the bridge goes on
        with suppress(OSError, SystemExit):
            if self.console.is_terminal and not self.as_json:
                with Live(console=self.console, auto_refresh=False, transient=True) as live:
                    self._follow(live)
            else:
                self._follow(None)

    def _follow(self, live: Live | None) -> None:
        while (item := self._waiting.get()) is not None:
            if isinstance(item, str):
                self._print_words(item)
            elif live is not None:
                words = Text(bridge_words(item), "dim")
                live.update(Group(drawn(poses_table(item.rows)), words), refresh=True)
            elif self.as_json:
                self._count += 1
                if self._count % _JSON_EVERY == 1:
                    self._print_json(bridge_object(item))
            else:
                self._print_changes(item.rows)

    def _print_words(self, words: str) -> None:
        if self.as_json:
            self._print_json({"event": words})
        else:
            _print(self.console, words)

    def _print_json(self, content: object) -> None:
        sys.stdout.write(json.dumps(content) + "\n")
        sys.stdout.flush()

    def _print_changes(self, rows: tuple[PoseRow, ...]) -> None:
        """Print what is wrong once, and that it is right again."""
        for row in rows:
            wrong = row.severity == "error"
            if wrong is not self._wrong.get(row.system):
                self._wrong[row.system] = wrong
                self._print_words(row.finding().message)


@click.command()
@click.argument("source", type=Address(parse_url), required=False)
@click.option(
    "--fleet", "fleet_file", type=FILE, required=True, help="Fleet file: vehicles and their links."
)
@click.option(
    "--identify",
    is_flag=True,
    help="Find bodies that are swapped, mirrored, turned, frozen, lost or flipping: asks to lift, "
    "lean and turn one vehicle after the other, and compares it with all bodies. Without SOURCE, "
    "with the poses of the bridge that runs.",
)
@click.option(
    "--record",
    type=FOLDER,
    help="With --identify: folder for the result. Default: a new folder in checks/.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print a JSON object a second, one a line, for scripts; with --identify, one at its end.",
)
@click.pass_context
def mocap(
    context: click.Context,
    source: str | None,
    fleet_file: Path,
    record: Path | None,
    *,
    identify: bool,
    as_json: bool,
) -> None:
    """Send the poses of a motion capture system to the vehicles, until Ctrl-C.

    SOURCE is KIND://HOST with vicon, optitrack, qualisys, vrpn and others of libmotioncapture, or
    udp://HOST:PORT.

    The bridge outlives the ground station: `swarm check` and `swarm fly` with the same fleet file
    find it, use its links, and send no poses themselves. While vehicles are armed, only a second
    Ctrl-C within 5 s ends it. Exit code 1 if the poses of these vehicles are sent already, or a
    body is not as it should be; 130 after Ctrl-C.

    Example: swarm mocap vicon://10.0.0.5 --fleet fleet.yaml
    """
    if record is not None and not identify:
        raise InputError("--record needs --identify")
    fleet = _laboratory_fleet(fleet_file)
    if identify:
        context.exit(_identify(fleet, source, record, as_json=as_json))
    if source is None:
        raise click.UsageError("Missing argument 'SOURCE'.")
    screen = Screen(Console(), as_json)
    with screen.running():
        serve(fleet, source, screen.show, screen.say)
    raise Interrupted("the bridge has ended: no vehicle gets poses")


def _identify(fleet: Fleet, source: str | None, record: Path | None, *, as_json: bool) -> int:
    """Guide a person through the identification of all bodies; return the exit code."""
    console = Console(stderr=as_json)
    folder = record or new_check_folder(Path("checks"))

    say = partial(_print, console)
    with console.status("listening") as status:
        say("Propellers off. All vehicles on the ground, and nothing else moved.")
        identification = identify_bodies(fleet, folder, source, say, status.update)
    result = identification_object(identification)
    if as_json:
        print_json(result | {"record": str(folder)})
    else:
        console.print()
        for finding in identification.findings():
            style = STYLES[SEVERITIES[finding.severity]]
            console.print(Text(finding.message, style), soft_wrap=not console.is_terminal)
        words = "Every vehicle has its own body." if result["passed"] else "NOT as it should be."
        console.print(Text(words, STYLES["good" if result["passed"] else "bad"]))
        console.print(f"Result: {folder / 'bodies.json'}", soft_wrap=True, highlight=False)
    return 0 if result["passed"] else 1


def _print(console: Console, words: str) -> None:
    """Print words: wrapped on a terminal, one line in a pipe."""
    console.print(words, soft_wrap=not console.is_terminal, highlight=False, markup=False)


def _laboratory_fleet(file: Path) -> Fleet:
    """Return a fleet whose vehicles can get poses; raises :class:`InputError` for another one."""
    fleet = load_fleet(file)
    if fleet.frame != "shared":
        raise InputError(f"{file}: frame: expected shared for motion capture, got {fleet.frame}")
    if fleet.emulated is not None:
        raise InputError(
            f"{file}: emulated: expected vehicles that run by themselves (also those of swarm "
            "sitl): the built-in emulator starts and ends with each command"
        )
    return fleet
