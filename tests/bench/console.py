"""How late setpoints are with browsers at the console, and without.

    python -m tests.bench.console [--clients 10] [--rounds 3] [--mission M]

Flights in real time on the built-in emulator, each with its console; every other one has clients in
a process of their own, which read every state and answer as a page does. Lateness is from when a
tick was due to when its setpoints were sent, by the flight's own clock; the gap is the longest time
between two ticks.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

SWARM = Path(sys.executable).with_name("swarm")
HOVER = Path(__file__).parents[2] / "missions" / "first-steps" / "hover.yaml"


def look_on(url: str, count: int) -> None:
    """Be so many browsers until the flight ends; print how many states each has seen."""
    parts, seen = urlsplit(url), [0] * count

    def one(k: int) -> None:
        origin = f"http://{parts.netloc}"
        with connect(f"ws://{parts.netloc}/socket", origin=origin, open_timeout=60.0) as client:
            client.send(json.dumps({"do": "join", "token": parts.fragment, "key": "", "name": ""}))
            try:
                while True:
                    if json.loads(client.recv())["kind"] == "state":
                        seen[k] += 1
                        client.send("drawn")
            except ConnectionClosed:
                return

    threads = [threading.Thread(target=one, args=(k,)) for k in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(f"          states seen: {min(seen)} to {max(seen)}", flush=True)


def flown(mission: str, clients: int) -> tuple[float, float, float]:
    """Return the median and the 99 % quantile of the lateness, and the longest gap, milliseconds."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        command = [SWARM, "fly", mission, "--json", "--record", "flight"]
        flight = subprocess.Popen(
            [*command, "--console", "127.0.0.1:0"],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert flight.stderr is not None
        for line in flight.stderr:
            if line.startswith("Console: ") and clients:
                arguments = ["--as-clients", line.split()[1], "--clients", str(clients)]
                own = [sys.executable, "-m", "tests.bench.console", *arguments]
                stack.callback(subprocess.Popen(own).wait)
            if line.startswith("Console: "):
                break
        out, _ = flight.communicate()
        outcome = json.loads(out)
    late = outcome["setpoint_lateness"]
    return 1e3 * late["median"], 1e3 * late["p99"], 1e3 * outcome["setpoint_gap"]["seconds"]


def main() -> None:
    """Fly, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--mission", default=str(HOVER))
    parser.add_argument("--as-clients", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.as_clients:
        # browsers run on other machines: these leave the processor to the flight
        os.setpriority(os.PRIO_PROCESS, 0, 19)
        look_on(given.as_clients, given.clients)
        return
    found: dict[int, list[tuple[float, float, float]]] = {0: [], given.clients: []}
    for _ in range(given.rounds):
        for clients, results in found.items():
            results.append(flown(given.mission, clients))
            p50, p99, gap = results[-1]
            print(
                f"{clients:3} clients: late p50 {p50:.2f} ms, p99 {p99:.2f} ms, gap {gap:.1f} ms",
                flush=True,
            )
    for clients, results in found.items():
        p50, p99, gap = np.median(results, axis=0)
        print(f"{clients:3} clients, medians: p50 {p50:.3f} ms, p99 {p99:.3f} ms, gap {gap:.1f} ms")


if __name__ == "__main__":
    main()
