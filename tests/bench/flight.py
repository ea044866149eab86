"""How well setpoints are timed at the receiver, and what the flight loop costs.

    python tests/bench/flight.py [--vehicles 100] [--rate 50] [--seconds 10] [--record] [--fifo]

A process stands in for the vehicles: it answers with heartbeats, positions and attitudes and notes
when each setpoint arrives. Against it run our flight loop and a plain pymavlink loop that does the
same work message by message. Lateness is against the sender's own grid, whose start is the
earliest that fits all arrivals.
"""

import argparse
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common

from swarm.fleet import Fleet, parse_fleet
from swarm.flight.conductor import Conductor
from swarm.ground.loop import Loop
from swarm.ground.record import Record
from swarm.ground.sockets import open_links
from swarm.mavlink.frames import shared_frames
from tests.network import small_plan

SETPOINT = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


def vehicles(count: int, port: int, seconds: float) -> None:
    """Stand in for the vehicles; print arrival times per vehicle as JSON."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
        one.setblocking(False)
    senders = [common.MAVLink(None, srcSystem=k + 1, srcComponent=1) for k in range(count)]
    arrivals: list[list[float]] = [[] for _ in range(count)]
    index = {one.fileno(): k for k, one in enumerate(sockets)}
    poll = select.epoll()
    for one in sockets:
        poll.register(one, select.EPOLLIN)
    end, next_tick, tick = time.monotonic() + seconds, time.monotonic(), 0
    while (now := time.monotonic()) < end:
        if now >= next_tick:
            next_tick += 0.1
            tick += 1
            for k, one in enumerate(sockets):
                _speak(one, senders[k], tick, port)
        for number, _ in poll.poll(max(0.0, next_tick - time.monotonic())):
            k = index[number]
            try:
                while True:
                    data = sockets[k].recv(2048)
                    if data[7] == SETPOINT:
                        arrivals[k].append(time.monotonic())
            except BlockingIOError:
                pass
    print(json.dumps(arrivals))


def _speak(one: socket.socket, mav: common.MAVLink, tick: int, port: int) -> None:
    messages = [common.MAVLink_local_position_ned_message(100 * tick, 0, 0, -5, 0, 0, 0)]
    if tick % 3 == 0:
        messages.append(common.MAVLink_heartbeat_message(2, 12, 129 | 64, 6 << 16, 4, 3))
    if tick % 5 == 0:
        messages.append(common.MAVLink_attitude_message(100 * tick, 0, 0, 0, 0, 0, 0))
    for message in messages:
        one.sendto(message.pack(mav), ("127.0.0.1", port))
        mav.seq = (mav.seq + 1) % 256


def fleet_of(count: int, rate: float) -> Fleet:
    listed = "\n".join(
        f"  - {{sysid: {k + 1}, links: [a], autopilot: px4, pad: {k + 1}}}" for k in range(count)
    )
    text = f'schema: 1\nname: bench\nlinks: {{a: "udpin://127.0.0.1:0"}}\nvehicles:\n{listed}\n'
    return parse_fleet(text, "bench", [f"rates.setpoint={rate}", "frame=shared"])


def ours(count: int, rate: float, seconds: float, folder: Path | None) -> dict[str, float]:
    """Run our flight loop, put into mid-fold."""
    proven = small_plan(vehicles=count)
    conductor = Conductor(proven, fleet_of(count, rate))
    links = open_links(conductor.fleet.links)
    child = spawn(count, links.port("a"), seconds)
    record = Record(folder, time.time()) if folder else None
    began = time.monotonic()

    def each_tick(_now: float) -> None:
        if conductor.stage == "prepare" and all(v.armed for v in conductor.flyers):
            conductor.frames = shared_frames(count)
            conductor._enter("fly")
            conductor.gate = 6
            conductor.clock.time = proven.plan.phase("fold").start
            conductor.streaming[:] = True
        conductor.clock.target = 0.0
        for event in conductor.events():
            if record is not None:
                record.event(event)
        if time.monotonic() - began > seconds - 1.0:
            conductor.give_up("enough")

    loop = Loop(conductor, links, record, 1.0, each_tick)
    loop.run()
    if record is not None:
        record.close()
    links.close()
    return {**lateness(child, rate), "cpu": loop.cpu}


def plain(count: int, rate: float, seconds: float) -> dict[str, float]:
    """Do the same work with one pymavlink message at a time and a sleeping loop."""
    ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ground.bind(("127.0.0.1", 0))
    ground.setblocking(False)
    child = spawn(count, ground.getsockname()[1], seconds)
    parser = common.MAVLink(None)
    parser.robust_parsing = True
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    addresses: dict[int, tuple[str, int]] = {}
    began, cpu = time.monotonic(), time.process_time()
    deadline = began
    while time.monotonic() - began < seconds - 1.0:
        try:
            while True:
                data, address = ground.recvfrom(2048)
                for message in parser.parse_buffer(data) or []:
                    addresses[message.get_srcSystem()] = address
        except BlockingIOError:
            pass
        for system, address in addresses.items():
            message = common.MAVLink_set_position_target_local_ned_message(
                0, system, 1, 1, 2048, 1.0, 2.0, -5.0, 0, 0, 0, 0, 0, 0, 0, 0
            )
            ground.sendto(message.pack(sender), address)
            sender.seq = (sender.seq + 1) % 256
        deadline += 1.0 / rate
        time.sleep(max(0.0, deadline - time.monotonic()))
    used = (time.process_time() - cpu) / (time.monotonic() - began)
    ground.close()
    return {**lateness(child, rate), "cpu": used}


def spawn(count: int, port: int, seconds: float) -> subprocess.Popen[bytes]:
    arguments = ["--as-vehicles", str(port), "--vehicles", str(count), "--seconds", str(seconds)]
    return subprocess.Popen([sys.executable, __file__, *arguments], stdout=subprocess.PIPE)


def lateness(child: subprocess.Popen[bytes], rate: float) -> dict[str, float]:
    """Median and 99 % of lateness at the receiver, in milliseconds, and how many arrived."""
    output, _ = child.communicate()
    late: list[float] = []
    total = 0
    for times in json.loads(output):
        arrived = np.array(times[int(rate) :])
        total += len(times)
        if len(arrived) < rate:
            continue
        slots = np.round((arrived - arrived[0]) * rate)
        off = arrived - slots / rate
        late.extend((off - off.min()).tolist())
    values = 1000.0 * np.array(late or [np.nan])
    return {
        "setpoints": float(total),
        "p50": float(np.quantile(values, 0.5)),
        "p99": float(np.quantile(values, 0.99)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--fifo", action="store_true")
    parser.add_argument("--as-vehicles", type=int)
    chosen = parser.parse_args()
    if chosen.as_vehicles:
        vehicles(chosen.vehicles, chosen.as_vehicles, chosen.seconds)
        return
    if chosen.fifo:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record" if chosen.record else None
        results = {
            "swarm": ours(chosen.vehicles, chosen.rate, chosen.seconds, record),
            "pymavlink": plain(chosen.vehicles, chosen.rate, chosen.seconds),
        }
    print(f"{chosen.vehicles} vehicles at {chosen.rate:g} Hz, load {os.getloadavg()[0]:.1f}")
    for name, figures in results.items():
        print(
            f"{name:10} {figures['setpoints']:8.0f} setpoints  late p50 {figures['p50']:6.2f} ms"
            f"  p99 {figures['p99']:6.2f} ms  cpu {figures['cpu']:6.1%} of one core"
        )
    print(f"cpu ratio {results['swarm']['cpu'] / results['pymavlink']['cpu']:.2f}")


if __name__ == "__main__":
    main()
