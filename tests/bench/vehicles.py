"""Stands in for vehicles when setpoints are timed: speaks as they do, notes what arrives when.

    python tests/bench/vehicles.py PORTS COUNT SECONDS FILE PRIORITY

PORTS is a JSON list: one port for all, or one each. Setpoints are kept in FILE (.npz): vehicle,
arrival, boot time and north. Arrival is when the system took the packet in, by its own stamp: how
soon this process gets round to reading it is not the sender's lateness.
"""

import gc
import json
import os
import select
import socket
import struct
import sys
import time
from contextlib import suppress

import numpy as np
from pymavlink.dialects.v20 import common

STAMPS = 35
"""SO_TIMESTAMPNS, which Python has no name for."""
SETPOINT = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


def vehicles(ports: list[int], count: int, seconds: float, path: str, priority: int) -> None:
    """Stand in for the vehicles; keep arrival, boot time and north of every setpoint."""
    gc.freeze()
    if priority:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
        one.setblocking(False)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        one.setsockopt(socket.SOL_SOCKET, STAMPS, 1)
    senders = [common.MAVLink(None, srcSystem=k + 1, srcComponent=1) for k in range(count)]
    targets = ports if len(ports) == count else ports * count
    arrivals: list[tuple[int, float, bytes]] = []
    index = {one.fileno(): k for k, one in enumerate(sockets)}
    poll = select.epoll()
    for one in sockets:
        poll.register(one, select.EPOLLIN)
    print("ready", flush=True)
    end, next_tick, tick = time.monotonic() + seconds, time.monotonic(), 0
    while (now := time.monotonic()) < end:
        if now >= next_tick:
            # a tenth of them at a time, so that speaking never keeps the receiver long
            next_tick += 0.01
            tick += 1
            for k in range(tick % 10, count, 10):
                _speak(sockets[k], senders[k], tick // 10, targets[k])
        for number, _ in poll.poll(max(0.0, next_tick - time.monotonic())):
            k = index[number]
            with suppress(BlockingIOError):
                while True:
                    data, ((_, _, stamp),), _, _ = sockets[k].recvmsg(2048, 64)
                    if data[7] == SETPOINT:
                        arrivals.append((k, stamp, data[10:18]))
    np.savez(
        path,
        vehicle=np.array([row[0] for row in arrivals]),
        arrived=np.array([_seconds(row[1]) for row in arrivals]) + _offset(),
        boot=np.array([int.from_bytes(row[2][:4], "little") for row in arrivals]),
        north=np.frombuffer(b"".join(row[2][4:8] for row in arrivals), "<f4"),
    )


def _seconds(stamp: bytes) -> float:
    whole, nanoseconds = struct.unpack("<qq", stamp[:16])
    return float(whole + 1e-9 * nanoseconds)


def _offset() -> float:
    """Seconds by which the monotonic clock is ahead of the system's."""
    found = [time.monotonic() - 0.5 * (time.time() + time.time()) for _ in range(100)]
    return float(np.median(found))


def _speak(one: socket.socket, mav: common.MAVLink, tick: int, port: int) -> None:
    messages = [common.MAVLink_local_position_ned_message(100 * tick, 0, 0, -5, 0, 0, 0)]
    if tick % 3 == 0:
        messages.append(common.MAVLink_heartbeat_message(2, 12, 129 | 64, 6 << 16, 4, 3))
    if tick % 5 == 0:
        messages.append(common.MAVLink_attitude_message(100 * tick, 0, 0, 0, 0, 0, 0))
    for message in messages:
        one.sendto(message.pack(mav), ("127.0.0.1", port))
        mav.seq = (mav.seq + 1) % 256


if __name__ == "__main__":
    vehicles(
        json.loads(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4], int(sys.argv[5])
    )
