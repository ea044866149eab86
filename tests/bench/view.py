"""Time of recording per tick at 20 Hz, and of queueing a snapshot in the flight.

Run: python -m tests.bench.view
"""

import pickle
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import rerun as rr

from swarm.flight.snapshot import Snapshot
from swarm.geometry.motion import through_states
from swarm.planning import Plan
from swarm.view.blueprint import flight_blueprint
from swarm.view.feeds import start
from swarm.view.rerun_scene import Recorder
from tests.reports.synthetic import snapshot_at, trefoil_plan

TICKS = 400
BUDGET = {9: 2.0, 100: 5.0}
"""Milliseconds of logging per tick, by number of vehicles."""


def crowd(count: int) -> Plan:
    """Return the made-up plan with its nine vehicles' motion repeated for ``count`` of them."""
    plan = trefoil_plan()
    index = np.arange(count) % plan.vehicles
    times = plan.motion.times
    place = plan.motion.at(times)[0][:, index]
    place = place + (np.arange(count) // plan.vehicles)[:, None] * np.array([0.0, 8.0, 0.0])
    rest = np.zeros_like(place)
    lengths = 1.2 * np.linalg.norm(np.diff(place, axis=1), axis=-1).max(axis=0)
    layout = replace(plan.layout, corners=place[5], lengths=lengths)
    return replace(plan, layout=layout, motion=through_states(times, place, rest, rest))


def milliseconds(plan: Plan, snapshots: list[Snapshot]) -> tuple[float, float]:
    """Return mean and 99 % of the processor time to log a tick, milliseconds."""
    with tempfile.TemporaryDirectory() as folder:
        stream = rr.RecordingStream("swarm")
        stream.set_log_tick_enabled(False)
        stream.set_log_time_enabled(False)
        stream.save(Path(folder) / "a.rrd", default_blueprint=flight_blueprint(plan, live=False))
        recorder = Recorder(stream, plan)
        took = []
        for snapshot in snapshots:
            began = time.thread_time()
            recorder.snapshot(snapshot)
            took.append(1e3 * (time.thread_time() - began))
        recorder.finish()
        stream.disconnect()
    return float(np.mean(took)), float(np.percentile(took, 99))


def offering(plan: Plan, snapshots: list[Snapshot]) -> float:
    """Return the mean time that offering a snapshot takes, microseconds."""
    with tempfile.TemporaryDirectory() as folder:
        viewer = start(plan, Path(folder) / "a.rrd", None)
        began = time.perf_counter()
        for snapshot in snapshots:
            viewer.offer(snapshot)
        took = 1e6 * (time.perf_counter() - began) / len(snapshots)
        viewer.close()
    return took


def main() -> None:
    """Print costs as shares of their budgets."""
    for count, budget in BUDGET.items():
        plan = crowd(count)
        snapshots = [
            replace(snapshot_at(plan, t), gripped=(True,) * count)
            for t in 40.0 + 0.05 * np.arange(TICKS)
        ]
        mean, late = milliseconds(plan, snapshots)
        pickled = len(pickle.dumps(snapshots[0]))
        print(
            f"{count:3d} vehicles: {mean:.2f} ms per tick ({mean / budget:.0%} of the budget), "
            f"99 % {late:.2f} ms; offering {offering(plan, snapshots):.1f} µs; "
            f"{pickled / 1024:.1f} KiB per snapshot"
        )


if __name__ == "__main__":
    main()
