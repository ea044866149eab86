"""The emulator's process in real time under full load: CPU time, lateness, rates at the receiver.

Starts ``python -m sitl`` with vehicles that send LOCAL_POSITION_NED at a rate (50 Hz) and ATTITUDE
at 10 Hz, sends setpoints to each at the same rate, and measures for some seconds. Lateness is the
delay of positions against an even rate, per vehicle, at the receiving socket.
Run: ``python tests/bench/sitl_realtime.py [vehicles] [hertz] [seconds]``.
"""

import contextlib
import json
import select
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as dialect

POSITION, ATTITUDE = 32, 30
Address = tuple[str, int]


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def exchange(
    sock: socket.socket, setpoints: list[tuple[Address, bytes]], rate: float, seconds: float
) -> list[tuple[float, bytes]]:
    """Send all setpoints at a rate; return the received datagrams with their times."""
    start = due = time.monotonic()
    datagrams = []
    while time.monotonic() < start + seconds:
        if time.monotonic() >= due:
            due += 1.0 / rate
            for address, data in setpoints:
                sock.sendto(data, address)
        select.select([sock], [], [], max(0.0, due - time.monotonic()))
        with contextlib.suppress(BlockingIOError):
            while True:
                datagrams.append((time.monotonic(), sock.recv(65535)))
    return datagrams


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    rate = float(sys.argv[2]) if len(sys.argv) > 2 else 50.0
    seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 10.0
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    began = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "sitl", "-n", str(count), "--json",
         "--target", f"127.0.0.1:{sock.getsockname()[1]}"],
        stdout=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    started = time.monotonic() - began
    addresses = {one["id"]: ("127.0.0.1", one["udp_local"]) for one in ready["vehicles"]}
    mav = dialect.MAVLink(None, 255, 190)
    for vehicle, address in addresses.items():
        for number in dialect.mavlink_map:
            if number not in {0, POSITION, ATTITUDE} and number < 300:
                message = dialect.MAVLink_command_long_message(
                    vehicle, 1, 511, 0, number, -1, 0, 0, 0, 0, 0
                )
                sock.sendto(message.pack(mav), address)
        for number, often in ((POSITION, rate), (ATTITUDE, 10)):
            message = dialect.MAVLink_command_long_message(
                vehicle, 1, 511, 0, number, 1e6 / often, 0, 0, 0, 0, 0
            )
            sock.sendto(message.pack(mav), address)
        select.select([], [], [], 0.002)
    setpoints = {
        vehicle: dialect.MAVLink_set_position_target_local_ned_message(
            0, vehicle, 1, 1, 3072, 0, 0, -3, *[0.0] * 8
        ).pack(mav)
        for vehicle in addresses
    }
    until = time.monotonic() + 2.0
    while time.monotonic() < until:
        select.select([sock], [], [], 0.1)
        while select.select([sock], [], [], 0)[0]:
            sock.recv(65535)
    cpu, start = cpu_seconds(process.pid), time.monotonic()
    datagrams = exchange(sock, [(addresses[i], setpoints[i]) for i in addresses], rate, seconds)
    used = (cpu_seconds(process.pid) - cpu) / (time.monotonic() - start)
    process.terminate()
    process.wait()
    arrivals: dict[int, list[float]] = {vehicle: [] for vehicle in addresses}
    attitudes = 0
    for now, data in datagrams:
        place = 0
        while place < len(data):
            number = struct.unpack("<I", data[place + 7 : place + 10] + b"\0")[0]
            if number == POSITION:
                arrivals[data[place + 5]].append(now)
            attitudes += number == ATTITUDE
            place += 12 + data[place + 1]
    late = []
    for times in arrivals.values():
        even = np.array(times) - np.arange(len(times)) / rate
        late.append(even - np.quantile(even, 0.02))
    lateness = np.maximum(np.concatenate(late), 0.0) * 1e3
    positions = sum(map(len, arrivals.values())) / seconds / count
    print(
        f"{count} vehicles: ready after {started:.2f} s, {100 * used:.0f} % of one core, "
        f"{positions:.1f} positions, {attitudes / seconds / count:.1f} attitudes a second each, "
        f"lateness p50 {np.quantile(lateness, 0.5):.2f} ms, "
        f"p99 {np.quantile(lateness, 0.99):.1f} ms"
    )


if __name__ == "__main__":
    main()
