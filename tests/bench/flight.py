"""How late setpoints arrive, and what the loop that sends them costs, beside other ways to do it.

    python -m tests.bench.flight [--vehicles 100] [--rate 50] [--seconds 15] [--normal] [--only X]

A process stands in for the vehicles: it speaks as they do and notes when each setpoint arrives (by
the system's stamp) and for which tick it was meant. Against it run: our flight loop with recording and a live view
(a terminal's screen and a Rerun file, drawn by a process of their own), a plain pymavlink loop, and
MAVSDK's offboard plugin, each at the same load. Before each of them a loop that does nothing but
wake up and send as many packets shows what the machine can do at that time. Where it is a virtual
one, `stolen` says how much of the processors its host took for others meanwhile, some milliseconds
at a time, whatever anybody's priority. Lateness is from when a tick was due, by the sender's
absolute schedule, to the arrival at the receiver, on one clock. With --normal nobody has real-time
priority; otherwise the receiver, the bare loop and ours have it where the system permits.
"""

import argparse
import json
import os
import pickle
import queue
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from mavsdk import Configuration, Mavsdk, log_subscribe
from mavsdk.plugins.offboard import (
    AccelerationNed,
    Offboard,
    PositionNedYaw,
    VelocityNedYaw,
)
from pymavlink.dialects.v20 import common
from rich.console import Console

from swarm import precompile
from swarm.flight.conductor import Conductor
from swarm.flight.stages import Stage
from swarm.ground.loop import Loop
from swarm.ground.priority import (
    configure_interpreter,
    lower_priority,
    raise_priority,
    run_behind_main_thread,
)
from swarm.ground.record import Record
from swarm.ground.sockets import open_links
from swarm.mavlink.frames import shared_frames
from swarm.mission.fleet import Fleet, parse_fleet
from swarm.reports.terminal import FlightScreen
from swarm.view import feeds
from tests.network import small_plan

WARM_UP = 3.0
_ROOT = Path(__file__).parents[2]


class Receiver:
    """The process of the vehicles."""

    def __init__(self, ports: list[int], chosen: argparse.Namespace) -> None:
        self._path = tempfile.mktemp(suffix=".npz")  # noqa: S306 - read back by us alone
        script = Path(__file__).with_name("vehicles.py")
        arguments = [json.dumps(ports), str(chosen.vehicles), str(chosen.seconds), self._path]
        arguments.append("0" if chosen.normal else "20")
        self._process = subprocess.Popen(
            [sys.executable, script, *arguments], stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def arrivals(self) -> dict[str, np.ndarray]:
        self._process.wait()
        with np.load(self._path) as data:
            found = dict(data)
        Path(self._path).unlink()
        return found


def fleet_of(count: int, rate: float) -> Fleet:
    listed = "\n".join(
        f"  - {{sysid: {k + 1}, links: [a], autopilot: px4, pad: {k + 1}}}" for k in range(count)
    )
    text = f'schema: 1\nname: bench\nlinks: {{a: "udpin://127.0.0.1:0"}}\nvehicles:\n{listed}\n'
    return parse_fleet(text, "bench", [f"rates.setpoint={rate}", "frame=shared"])


def watch(number: int, folder: str) -> None:
    """Draw what comes over a pipe, as `swarm fly --view` does."""
    with Connection(number) as pipe, open(os.devnull, "w") as nowhere:
        plan = pipe.recv()
        viewer = feeds.start(plan, Path(folder) / "flight.rrd", None)
        console = Console(file=nowhere, force_terminal=True, width=120, height=50)
        with FlightScreen(plan, console) as screen, suppress(EOFError):
            while True:
                snapshot = pipe.recv()
                screen.show(snapshot)
                viewer.offer(snapshot)
        viewer.close()


class Watcher:
    """The process that draws, fed ten times a second by a thread that alone waits for it."""

    def __init__(self, plan: object, folder: Path) -> None:
        ours, theirs = socket.socketpair()
        arguments = ["--as-watcher", str(theirs.fileno()), "--path", str(folder)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.bench.flight", *arguments],
            pass_fds=[theirs.fileno()],
            cwd=_ROOT,
        )
        theirs.close()
        lower_priority(self._process.pid)
        self._pipe = Connection(ours.detach())
        self._pipe.send(plan)
        self._waiting: queue.Queue[object] = queue.Queue(200)
        threading.Thread(target=self._feed, daemon=True).start()

    def _feed(self) -> None:
        run_behind_main_thread()
        while (snapshot := self._waiting.get()) is not None:
            self._pipe.send_bytes(pickle.dumps(snapshot))

    def offer(self, snapshot: object) -> None:
        with suppress(queue.Full):
            self._waiting.put_nowait(snapshot)

    def close(self) -> None:
        self._pipe.close()
        self._process.wait()


def ours(
    chosen: argparse.Namespace, folder: Path
) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
    """Run our flight loop, put into mid-fold."""
    count, rate = chosen.vehicles, chosen.rate
    flight_plan, fleet = small_plan(vehicles=count), fleet_of(count, rate)
    conductor = Conductor(flight_plan, fleet)
    precompile.load()
    links = open_links(conductor.fleet.links)
    (configure_interpreter if chosen.normal else raise_priority)()
    record = Record(folder / "record", time.time())
    watcher = Watcher(flight_plan.plan, folder)
    receiver = Receiver([links.port("a")], chosen)
    began = time.monotonic()
    shown = [0.0]

    def each_tick(now: float) -> None:
        if conductor.stage == "prepare" and all(v.armed for v in conductor.flyers):
            flight = conductor.state
            flight.placement.frames = shared_frames(count)
            flight.stage, flight.progress.gate = Stage.EXECUTE, 6
            conductor.clock.time = flight_plan.plan.phase("fold").start
            flight.streams.active = np.ones(count, dtype=bool)
        conductor.clock.target = 0.0
        for event in conductor.events():
            record.event(event)
        if now >= shown[0]:
            shown[0] = now + 0.1
            watcher.offer(conductor.snapshot(now))
        if time.monotonic() - began > chosen.seconds - 1.0:
            conductor.give_up("enough")

    loop = Loop(conductor, links, record, 1.0, each_tick)
    loop.run()
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    record.close()
    links.close()
    watcher.close()
    found = receiver.arrivals()
    # boot times are cut off to milliseconds: the tick is the one that began within the next
    due = loop.start_time + np.floor((found["boot"] * 1e-3 + 1.5e-3) * rate) / rate
    return found, due, loop.cpu


def plain(chosen: argparse.Namespace, _: Path) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
    """Do the same work with one pymavlink message at a time and a sleeping loop."""
    ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ground.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
    ground.bind(("127.0.0.1", 0))
    ground.setblocking(False)
    receiver = Receiver([ground.getsockname()[1]], chosen)
    parser = common.MAVLink(None)
    parser.robust_parsing = True
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    addresses: dict[int, tuple[str, int]] = {}
    began, cpu = time.monotonic(), time.process_time()
    tick = 0
    while time.monotonic() - began < chosen.seconds - 1.0:
        with suppress(BlockingIOError):
            while True:
                data, address = ground.recvfrom(2048)
                for message in parser.parse_buffer(data) or []:
                    addresses[message.get_srcSystem()] = address
        for system, address in addresses.items():
            message = common.MAVLink_set_position_target_local_ned_message(
                0, system, 1, 1, 2048, float(tick), 2.0, -5.0, 0, 0, 0, 0, 0, 0, 0, 0
            )
            ground.sendto(message.pack(sender), address)
            sender.seq = (sender.seq + 1) % 256
        tick += 1
        time.sleep(max(0.0, began + tick / chosen.rate - time.monotonic()))
    used = (time.process_time() - cpu) / (time.monotonic() - began)
    ground.close()
    found = receiver.arrivals()
    return found, began + found["north"] / chosen.rate, used


def with_mavsdk(
    chosen: argparse.Namespace, _: Path
) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
    """Send the same with MAVSDK's offboard plugin, one connection per vehicle."""
    log_subscribe(lambda *_: True)
    ports = []
    for _number in range(chosen.vehicles):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            ports.append(free.getsockname()[1])
    with Mavsdk(Configuration.create_manual(255, 190, True)) as mavsdk:
        for port in ports:
            mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        receiver = Receiver(ports, chosen)
        began, cpu, tick = time.monotonic(), time.process_time(), 0
        plugins: dict[int, Offboard] = {}
        still, rest = VelocityNedYaw(0, 0, 0, 0), AccelerationNed(0, 0, 0)
        while time.monotonic() - began < chosen.seconds - 1.0:
            if len(plugins) < chosen.vehicles and tick % 10 == 0:
                for system in mavsdk.get_systems():
                    number = system.get_system_id()
                    if number and number not in plugins:
                        plugins[number] = Offboard(system)
            for plugin in plugins.values():
                place = PositionNedYaw(float(tick), 2.0, -5.0, 0.0)
                plugin.set_position_velocity_acceleration_ned(place, still, rest)
            tick += 1
            time.sleep(max(0.0, began + tick / chosen.rate - time.monotonic()))
        used = (time.process_time() - cpu) / (time.monotonic() - began)
    found = receiver.arrivals()
    _, first = np.unique(found["vehicle"] * 1e7 + found["north"], return_index=True)
    found = {name: column[np.sort(first)] for name, column in found.items()}
    return found, began + found["north"] / chosen.rate, used


def bare(chosen: argparse.Namespace) -> np.ndarray:
    """Return how late a loop is that only wakes up and sends as many packets: the machine's own."""
    script = (
        "import json, socket, sys, time\n"
        "from swarm.ground.priority import raise_priority, configure_interpreter\n"
        "(raise_priority if sys.argv[3] == '1' else configure_interpreter)()\n"
        "one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "one.bind(('127.0.0.1', 0))\n"
        "place, packet = one.getsockname(), bytes(65)\n"
        "late, interval, due = [], 1.0 / float(sys.argv[1]), time.monotonic()\n"
        "for tick in range(int(float(sys.argv[2]) / interval)):\n"
        "    due += interval\n"
        "    time.sleep(max(0.0, due - time.monotonic()))\n"
        "    for _ in range(int(sys.argv[4])):\n"
        "        one.sendto(packet, place)\n"
        "        late.append(time.monotonic() - due)\n"
        "print(json.dumps(late))\n"
    )
    arguments = [
        str(chosen.rate),
        str(chosen.seconds),
        "0" if chosen.normal else "1",
        str(chosen.vehicles),
    ]
    found = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        cwd=_ROOT, check=True, stdout=subprocess.PIPE,
    )  # fmt: skip
    return np.array(json.loads(found.stdout))


def stolen() -> float:
    """Return the processors' time in seconds that a virtual machine's host has taken for others."""
    with suppress(OSError, IndexError, ValueError):
        first = Path("/proc/stat").read_text().splitlines()[0]
        return int(first.split()[8]) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _share(taken: float, since: float) -> str:
    return f"  stolen {(stolen() - taken) / (time.monotonic() - since):5.1%}"


def in_words(late: np.ndarray) -> str:
    """Return lateness in seconds as its quantiles."""
    p50, p99, worst = 1000.0 * np.quantile(late, [0.5, 0.99, 1.0])
    return f"late p50 {p50:6.2f} ms  p99 {p99:6.2f} ms  worst {worst:6.1f} ms"


WAYS = {"swarm": ours, "pymavlink": plain, "MAVSDK": with_mavsdk}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--normal", action="store_true", help="no real-time priority")
    parser.add_argument("--only", choices=list(WAYS))
    parser.add_argument("--as-watcher", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--path", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.as_watcher:
        watch(chosen.as_watcher, chosen.path)
        return
    print(
        f"{chosen.vehicles} vehicles at {chosen.rate:g} Hz for {chosen.seconds:g} s, "
        f"{'normal' if chosen.normal else 'real-time'} priority, load {os.getloadavg()[0]:.1f} "
        f"on {os.cpu_count()} cores"
    )
    used: dict[str, float] = {}
    for name, way in WAYS.items():
        if chosen.only not in {None, name}:
            continue
        taken, since = stolen(), time.monotonic()
        print(f"{'(machine)':10} {'':29}{in_words(bare(chosen))}{_share(taken, since)}")
        taken, since = stolen(), time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            found, due, used[name] = way(chosen, Path(folder))
        settled = found["arrived"] > found["arrived"].min() + WARM_UP
        late = (found["arrived"] - due)[settled]
        duration = np.ptp(found["arrived"][settled])
        share = settled.sum() / (chosen.vehicles * chosen.rate * duration)
        print(
            f"{name:10} {share:6.1%} of setpoints arrived, {in_words(late)}"
            f"{_share(taken, since)}  cpu {used[name]:6.1%} of one core"
        )
    if len(used) == len(WAYS):
        print(
            f"cpu: {used['swarm'] / used['pymavlink']:.2f} of pymavlink's, "
            f"{used['swarm'] / used['MAVSDK']:.2f} of MAVSDK's"
        )


if __name__ == "__main__":
    main()
