"""The bridge of motion capture in a process of its own, ``swarm mocap``.

It opens the links of a fleet and sends each vehicle its poses, whatever becomes of the ground
station. A ground station that finds it borrows the links: it gets their descriptors over a local
socket, so that its packets go to the vehicles as without a bridge, and go on to do so if the bridge
ends. The bridge sends poses on the same sockets meanwhile, but only one process may receive: the
borrower does, and passes on copies. When it ends, however it ends, the bridge receives again.

Two senders of poses for one vehicle would be worse than none. A process that sends poses claims the
links with a locked file in a folder of this account; claimed links are borrowed or refused. A
vehicle that two bridges reach on links with different URLs, or from two machines, is not noticed.

The bridge is no ground station: its packets have a system id of their own, and its heartbeats a
type of their own, so that autopilots notice the loss of the ground station as without it (ArduPilot
by SYSID_MYGCS, PX4 by the type).
"""

import fcntl
import json
import os
import select
import signal
import socket
import stat
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from pymavlink.dialects.v20 import common

from swarm.errors import InputError, Problem, Refused, VehicleError
from swarm.flight.bodies import Body, Pose, PoseRow, pose_rows
from swarm.flight.router import Address, Outgoing, Team
from swarm.ground.mocap import Capture, MocapBridge, open_capture, origin_of
from swarm.ground.operator import signal_handlers
from swarm.ground.signing_key import signing_with
from swarm.ground.sockets import Links, borrowed_links, open_links
from swarm.mission.fleet import Fleet

SYSTEM, COMPONENT = 254, int(common.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY)
"""The bridge on the links; fleets have system ids up to 250, ground stations 255."""
_HEARTBEAT = common.MAVLink_heartbeat_message(
    common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, 0,
    common.MAV_STATE_ACTIVE, 3,
)  # fmt: skip
_HEARTBEAT_INTERVAL = 1.0
_SHOWN_INTERVAL, _FIRST_SHOWN = 0.5, 2.0
"""Seconds between two states for the screen, and before the first: vehicles send a heartbeat each
second."""
_LARGEST_MESSAGE = 1 << 17
"""Bytes of a message on the local socket: poses of 250 bodies have 40,000, datagrams 65,536."""
_ANSWERS = 3.0
"""Seconds within which a bridge answers: sixty ticks at the lowest usual rate, 20 Hz."""
_AGAIN = 5.0
"""Seconds within which a second interrupt ends a bridge whose vehicles are armed."""
_BORROW = b"borrow "


@dataclass(frozen=True)
class Claim:
    """Who sends poses: process, source, the fleet's name, links (name → URL) and system ids.

    ``address`` is the local socket of a bridge; None for a flight that sends poses itself.
    """

    process: int
    source: str
    fleet: str
    links: Mapping[str, str]
    systems: Sequence[int]
    address: str | None = None


@contextmanager
def claimed(fleet: Fleet, source: str, address: str | None = None) -> Iterator[None]:
    """Claim the links of a fleet for the poses of a source until the block ends.

    Raises :class:`Refused` where another process sends poses on one of them.
    """
    claim = Claim(os.getpid(), source, fleet.name, fleet.links, fleet.systems, address)
    with _locked_folder() as folder:
        for other in _claims(folder):
            if shared := sorted({*other.links.values()} & {*fleet.links.values()}):
                raise Refused(f"{_who(other)} already sends poses on {', '.join(shared)}")
        path = folder / f"{claim.process}-{time.monotonic_ns()}.json"
        file = path.open("w", encoding="utf-8")
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(json.dumps(vars(claim)))
        file.flush()
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        file.close()


@contextmanager
def open_mocap(source: str, fleet: Fleet, team: Team) -> Iterator[MocapBridge]:
    """Open a bridge within the ground station, which ends with the block."""
    with ExitStack() as resources:
        if fleet.emulated is None:
            resources.enter_context(claimed(fleet, source))
        capture: Capture = open_capture(source)
        resources.callback(capture.close)
        yield MocapBridge(capture, team, origin_of(fleet))


def running_bridge(fleet: Fleet, source: str | None) -> Claim | None:
    """Return the bridge that sends the poses of a fleet, None without one.

    ``source`` is the one that the caller would send poses from. Raises :class:`Refused` where
    links are claimed that cannot be borrowed for this fleet and this source.
    """
    if fleet.emulated is not None:
        return None
    with _locked_folder() as folder:
        claims = _claims(folder)
    for claim in claims:
        shared = sorted({*claim.links.values()} & {*fleet.links.values()})
        if not shared:
            continue
        who = _who(claim)
        if claim.address is None:
            raise Refused(f"{who} already sends poses on {', '.join(shared)}")
        if dict(claim.links) != fleet.links or tuple(claim.systems) != fleet.systems:
            words = f"{who} sends poses to another fleet ({claim.fleet}) on {', '.join(shared)}"
            raise Refused(f"{words}: end it, or use its fleet file")
        if source not in (None, claim.source):
            raise Refused(f"--mocap {source}: {who} sends the poses: leave --mocap out, or end it")
        return claim
    return None


def _who(claim: Claim) -> str:
    kind = "flight" if claim.address is None else "bridge of motion capture"
    return f"the {kind} in process {claim.process} ({claim.source})"


@contextmanager
def _locked_folder() -> Iterator[Path]:
    """Yield the folder of the claims of this account, locked."""
    folder = Path(tempfile.gettempdir()) / f"swarm-mocap-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
            raise InputError([Problem(str(folder), "expected a folder of this account")])
        with (folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield folder
    except OSError as error:
        raise InputError([Problem(str(folder), str(error.strerror or error))]) from None


def _claims(folder: Path) -> list[Claim]:
    """Return the claims of processes that run; files of others are removed."""
    claims = []
    for path in sorted(folder.glob("*.json")):
        with path.open(encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                claims.append(Claim(**json.loads(file.read())))
            else:
                path.unlink()
    return claims


@dataclass(frozen=True)
class BridgeState:
    """The bridge at one moment, for its screen: a row for each vehicle, and bodies of no vehicle.

    ``borrower`` is the process id of the ground station that has the links, None without one.
    """

    rows: tuple[PoseRow, ...]
    strangers: tuple[int, ...]
    armed: tuple[int, ...]
    borrower: int | None


@dataclass
class Bridge:
    """Sends poses until it is interrupted; ``show`` gets its state twice a second, ``say`` words.

    Neither may block: poses would stop.
    """

    poses: MocapBridge
    links: Links
    listening: socket.socket
    source: str
    rate: float
    show: Callable[[BridgeState], None]
    say: Callable[[str], None]
    _borrower: socket.socket | None = None
    _borrowed_by: int = 0
    _guests: list[socket.socket] = field(default_factory=list)
    _signals: list[int] = field(default_factory=list)
    _asked: float | None = None
    _hung_up: bool = False
    _ended: bool = False
    _next_heartbeat: float = 0.0
    _next_shown: float = _FIRST_SHOWN
    _bugs: set[str] = field(default_factory=set)

    def run(self) -> None:
        """Run until the first interrupt; until the second one while vehicles are armed.

        Without its terminal the bridge goes on as long as it is needed.
        """
        interval = 1.0 / self.rate
        began = time.monotonic()
        deadline = began
        with signal_handlers((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), self.ask):
            while not self._ended:
                try:
                    self._receive(began, deadline)
                    self._tick(time.monotonic() - began)
                except Exception as error:
                    # nine vehicles on one cable need the next poses, whatever was wrong with these
                    self._report_bug(error)
                self._obey(time.monotonic() - began)
                deadline += interval * max(1.0, (time.monotonic() - deadline) // interval)
        for connection in (self._borrower, *self._guests):
            if connection is not None:
                connection.close()

    def _tick(self, now: float) -> None:
        """Send what is due, and serve who asks."""
        outgoing = list(self.poses.packets(now))
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + _HEARTBEAT_INTERVAL
            outgoing += self._heartbeats()
        self.links.send(outgoing)
        self._serve(now)
        if (change := self.poses.change(now)) is not None:
            self.say(change[1])
        if now >= self._next_shown:
            self._next_shown = now + _SHOWN_INTERVAL
            self.show(self._state(now))

    def _report_bug(self, error: Exception) -> None:
        """Say once what went wrong in a tick."""
        where = traceback.extract_tb(error.__traceback__)[-1]
        words = f"swarm has a bug: {type(error).__name__}: {error} ({where.name}, line "
        words += f"{where.lineno}); poses go on"
        if words not in self._bugs:
            self._bugs.add(words)
            self.say(words)

    def _receive(self, began: float, until: float) -> None:
        """Receive packets of the vehicles until a time, unless the links are borrowed."""
        self.poses.team.read_unknown_again()
        while (wait := until - time.monotonic()) > 0.0:
            if self._borrower is not None:
                time.sleep(wait)
                return
            for link, address, data in self.links.wait(wait):
                self.poses.team.receive(link, address, data, time.monotonic() - began)

    def _heartbeats(self) -> Iterator[Outgoing]:
        """Yield heartbeats on all routes: some vehicles answer only to those who send them."""
        for route in self.poses.team.routes():
            yield self.poses.on_route(route, _HEARTBEAT)

    def _serve(self, now: float) -> None:
        """Read what the borrower passes on, tell it the poses, and answer those who ask."""
        with suppress(BlockingIOError):
            while True:
                guest, _ = self.listening.accept()
                guest.setblocking(False)
                self._guests.append(guest)
        if self._borrower is not None:
            self._read_copies(self._borrower, now)
        for guest in tuple(self._guests):
            try:
                request = guest.recv(_LARGEST_MESSAGE)
            except BlockingIOError:
                continue
            except OSError:
                request = b""
            self._guests.remove(guest)
            if request.startswith(_BORROW) and request[len(_BORROW) :].isdigit():
                self._lend(guest, int(request[len(_BORROW) :]))
            else:
                guest.close()
        if self._borrower is not None:
            with suppress(OSError):
                self._borrower.send(_bodies_message(self.poses.bodies(now)))

    def _lend(self, guest: socket.socket, process: int) -> None:
        if self._borrower is not None:
            with suppress(OSError):
                guest.send(json.dumps({"refused": self._borrowed_by}).encode())
            guest.close()
            return
        ports = list(self.links.ports.values())
        answer = {"source": self.source, "ports": [port.described() for port in ports]}
        try:
            socket.send_fds(guest, [json.dumps(answer).encode()], [port.fileno() for port in ports])
        except OSError:
            guest.close()
            return
        self._borrower, self._borrowed_by = guest, process
        self.say(f"process {process} uses the links")

    def _read_copies(self, borrower: socket.socket, now: float) -> None:
        try:
            while data := borrower.recv(_LARGEST_MESSAGE):
                head, _, packet = data.partition(b"\n")
                link, address = json.loads(head)
                place = tuple(address) if isinstance(address, list) else address
                self.poses.team.receive(link, place, packet, now)
        except BlockingIOError:
            return
        except OSError:
            pass
        borrower.close()
        self._borrower = None
        self.say(f"process {self._borrowed_by} has ended, or returned the links; poses go on")

    def _state(self, now: float) -> BridgeState:
        vehicles = self.poses.team.vehicles
        bodies = self.poses.bodies(now)
        return BridgeState(
            pose_rows(vehicles.values(), bodies, now, positions=False),
            tuple(sorted(set(bodies) - set(vehicles))),
            self._armed(),
            self._borrowed_by if self._borrower is not None else None,
        )

    def _armed(self) -> tuple[int, ...]:
        return tuple(v.system for v in self.poses.team.vehicles.values() if v.armed)

    def ask(self, number: int, _frame: FrameType | None = None) -> None:
        """Note a signal; it is obeyed after the next tick."""
        self._signals.append(number)

    def _obey(self, now: float) -> None:
        """End where that was asked for, and no armed vehicle needs poses, or asked for again."""
        while self._signals:
            number = self._signals.pop()
            armed = self._armed()
            if number == signal.SIGHUP:
                self._hung_up = True
            elif not armed or (self._asked is not None and now - self._asked <= _AGAIN):
                self._ended = True
            else:
                self._asked = now
                names = ", ".join(map(str, armed))
                self.say(
                    f"NOT ended: system {names} is armed, and without poses loses its position. "
                    f"Again within {_AGAIN:g} s ends the bridge all the same."
                )
        if self._hung_up and self._borrower is None and not self._armed():
            self._ended = True


def serve(
    fleet: Fleet,
    source: str,
    show: Callable[[BridgeState], None],
    say: Callable[[str], None],
) -> None:
    """Run the bridge of a fleet from a source, see :class:`Bridge`, until it is interrupted.

    Raises :class:`Refused` where another one sends poses to these vehicles, and
    :class:`VehicleError` for links or a source that cannot be opened.
    """
    with ExitStack() as resources:
        with _locked_folder() as folder:
            path = folder / f"{os.getpid()}.sock"
        resources.enter_context(claimed(fleet, source, str(path)))
        capture: Capture = open_capture(source)
        resources.callback(capture.close)
        links = open_links(fleet.links)
        resources.callback(links.close)
        team = Team(fleet, lambda _kind, words, _system: say(words))
        team.signing = resources.enter_context(signing_with(fleet.signing_key))
        path.unlink(missing_ok=True)
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        resources.callback(listening.close)
        listening.bind(str(path))
        resources.callback(path.unlink, missing_ok=True)
        listening.listen()
        listening.setblocking(False)
        poses = MocapBridge(capture, team, origin_of(fleet), (SYSTEM, COMPONENT))
        say(
            f"{fleet.name}: poses from {source} to {len(fleet.vehicles)} vehicles, at most "
            f"{fleet.rates.setpoint:g} a second each; Ctrl-C ends them"
        )
        Bridge(poses, links, listening, source, fleet.rates.setpoint, show, say).run()


@dataclass
class Borrowed:
    """The links of a bridge that sends the poses; a feed and a copy of :class:`~swarm.ground.loop`.

    ``source`` and ``process`` are the bridge's.
    """

    links: Links
    source: str
    process: int
    _connection: socket.socket
    _bodies: Mapping[int, Body] = field(default_factory=dict)
    _told_at: float = 0.0
    _said: str = ""
    _ended: bool = False

    def packets(self, now: float) -> tuple[Outgoing, ...]:
        """Take what the bridge has told by ``now``; it sends the poses itself."""
        with suppress(BlockingIOError):
            while not self._ended:
                try:
                    told = self._connection.recv(_LARGEST_MESSAGE)
                except ConnectionError:
                    told = b""
                if told:
                    self._bodies, self._told_at = _read_bodies(told), now
                else:
                    self._ended = True
        return ()

    def bodies(self, now: float) -> Mapping[int, Body]:
        """Return what has come of each body, by the system id of its vehicle."""
        late = now - self._told_at
        return {system: body._replace(age=body.age + late) for system, body in self._bodies.items()}

    def change(self, now: float) -> tuple[str, str] | None:  # noqa: ARG002 - a feed
        """Return an event: which process sends the poses, or that none does any more."""
        if self.words == self._said:
            return None
        self._said = self.words
        return "motion capture", self.words

    @property
    def words(self) -> str:
        """The process that sends the poses, in words."""
        if self._ended:
            return f"the bridge in process {self.process} has ended: no vehicle gets poses"
        return f"the bridge in process {self.process} sends the poses ({self.source})"

    def from_vehicles(self, link: str, address: Address | None, data: bytes) -> None:
        """Pass on a copy of what a vehicle has sent; none waits for a slow bridge."""
        if not self._ended:
            with suppress(OSError):
                self._connection.send(json.dumps((link, address)).encode() + b"\n" + data)

    def close(self) -> None:
        """Return the links."""
        self._connection.close()


@contextmanager
def links_of(fleet: Fleet, source: str | None) -> Iterator[tuple[Links, Borrowed | None]]:
    """Open the links of a fleet, or borrow them of the bridge that runs for it.

    ``source`` is that of a bridge that the caller would open itself. Raises :class:`Refused` where
    that would be a second sender of poses, or where another ground station has the links.
    """
    claim = running_bridge(fleet, source)
    if claim is None:
        links, borrowed = open_links(fleet.links), None
    else:
        borrowed = _borrow(claim)
        links = borrowed.links
    try:
        yield links, borrowed
    finally:
        links.close()
        if borrowed is not None:
            borrowed.close()


def _borrow(claim: Claim) -> Borrowed:
    """Borrow the links of a bridge."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    words = f"{_who(claim)} does not answer"
    descriptors: list[int] = []
    try:
        connection.connect(str(claim.address))
        connection.send(_BORROW + str(os.getpid()).encode())
        if not select.select([connection], [], [], _ANSWERS)[0]:
            raise VehicleError(words)
        told, descriptors, _, _ = socket.recv_fds(connection, _LARGEST_MESSAGE, len(claim.links))
        answer = json.loads(told)
    except (OSError, ValueError):
        connection.close()
        raise VehicleError(words) from None
    except VehicleError:
        connection.close()
        raise
    if "refused" in answer:
        connection.close()
        raise Refused(f"process {answer['refused']} uses the links of {_who(claim)}")
    connection.setblocking(False)
    links = borrowed_links(answer["ports"], descriptors)
    return Borrowed(links, answer["source"], claim.process, connection)


def _bodies_message(bodies: Mapping[int, Body]) -> bytes:
    rows = [
        [*pose[:2], pose.position, pose.attitude, rate, age, unchanged]
        for pose, rate, age, unchanged in bodies.values()
    ]
    return json.dumps(rows).encode()


def _read_bodies(data: bytes) -> dict[int, Body]:
    """Return the bodies of a message of the bridge."""
    rows: list[list[Any]] = json.loads(data)
    return {
        system: Body(Pose(system, at, tuple(place), tuple(turn)), *rest)
        for system, at, place, turn, *rest in rows
    }
