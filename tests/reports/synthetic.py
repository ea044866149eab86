"""A synthetic flight of nine vehicles into a trefoil on a 5×5 grid, for tests of pictures.

It is not certified: the team moves on straight lines.
"""

import numpy as np
import numpy.typing as npt

from swarm.certification.monitor import Clearances
from swarm.flight.snapshot import Event, Snapshot
from swarm.geometry.catenary import length_for_sag
from swarm.geometry.motion import through_states
from swarm.mission import mission_for_knot
from swarm.planning import CableState, Gate, KnotLayout, KnotSummary, Phase, PhaseName, Plan

Floats = npt.NDArray[np.float64]

TREFOIL = ((0, 2), (2, 2), (2, 4), (4, 4), (4, 1), (1, 1), (1, 3), (3, 3), (3, 0))
CROSSINGS = ((1, 6), (5, 0), (7, 4))
PHASES: tuple[tuple[PhaseName, float, CableState, bool], ...] = (
    ("takeoff", 6.0, "floor", False),
    ("grab", 10.0, "floor", False),
    ("contract", 10.0, "floor", False),
    ("lift", 8.0, "lifting", False),
    ("fold", 36.0, "aloft", True),
    ("hold", 4.0, "aloft", True),
    ("finish", 5.0, "free", False),
    ("land", 10.0, "free", False),
)


def trefoil_plan(fence: tuple[tuple[float, float], ...] | None = None) -> Plan:
    """Return an unchecked plan with every phase."""
    mission = mission_for_knot("overhand", ["vehicles.tracking=0.1"])
    if fence is not None:
        workspace = mission.workspace.model_copy(update={"fence": fence})
        mission = mission.model_copy(update={"workspace": workspace})
    cell, height = 1.2, 6.0
    corners = np.column_stack([cell * (np.array(TREFOIL, float) - 2.0), np.full(9, height)])
    sags = np.where(np.arange(8) % 2 == 1, 0.8, 1.9)
    spans = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    lengths = np.asarray(length_for_sag(spans, sags))
    lanes = np.where(np.arange(8) % 2 == 1, 1.6, -1.6)
    layout = KnotLayout(corners, sags, lengths, lanes, CROSSINGS, cell)
    places = _places(corners, lengths)
    times = np.concatenate([[0.0], np.cumsum([phase[1] for phase in PHASES])])
    rest = np.zeros_like(places)
    motion = through_states(times, places, rest, rest)
    phases = tuple(
        Phase(name, float(start), float(end), cable, reversible)
        for (name, _, cable, reversible), start, end in zip(
            PHASES, times[:-1], times[1:], strict=True
        )
    )
    gates = (
        Gate(0.0, "armed", 30.0),
        Gate(phases[0].end, "airborne", 30.0),
        Gate(phases[1].end, "gripped", 30.0),
        Gate(phases[5].end, "released", 10.0),
        Gate(phases[7].end, "landed", 60.0),
    )
    knot = KnotSummary(
        "3_1", "right", "1- 2+ 3- 1+ 2- 3+", ((0, 2), (1, 3), (2, 4), (0, 3), (1, 4))
    )
    return Plan(mission, knot, layout, motion, phases, gates, _path(corners, lanes, cell))


def fly(plan: Plan, rate: float = 20.0, duration: float | None = None) -> list[Snapshot]:
    """Return the snapshots of a flight of that plan without failures."""
    return [snapshot_at(plan, time) for time in np.arange(0.0, duration or plan.duration, 1 / rate)]


def snapshot_at(plan: Plan, time: float) -> Snapshot:
    """Return the team at one moment: a smooth tracking error of some centimetres each."""
    n = plan.vehicles
    position, velocity, _ = plan.motion.at(time)
    each = np.arange(n)
    wave = np.stack([np.sin(0.7 * time + 1.3 * each + axis) for axis in range(3)], axis=-1)
    flying = float(plan.phases[0].start < time < plan.phases[-1].end)
    armed = 1.0 < time < plan.duration - 1.0
    gripping = plan.phase("grab").start + 1.0 + each
    gripped = (time >= gripping) & (time < plan.phase("finish").start)
    return Snapshot(
        time=float(time),
        mission_time=float(time),
        rate=1.0 if abs(time - 50.0) > 3 else 0.4,
        phase=plan.phase_at(float(time)).name,
        waiting_for="all vehicles to grip the cable (gate before contract)"
        if plan.phase_at(float(time)).name == "grab"
        else None,
        position=position + flying * 0.03 * wave,
        velocity=velocity,
        setpoint=position,
        modes=("OFFBOARD" if armed else "HOLD",) * n,
        states=("flying" if armed else "standby",) * n,
        armed=(armed,) * n,
        gripped=tuple(bool(g) for g in gripped),
        battery=np.clip(1.0 - time / 400.0 - 0.004 * each, 0.0, 1.0),
        link_age=0.02 + 0.02 * np.abs(np.sin(3.1 * time + each)),
        clearances=Clearances(0.6, 2.1, 0.93, 0.3 + 0.1 * np.sin(time), "cable clearance")
        if gripped.all()
        else None,
        round_trip=0.02 + 0.01 * np.abs(np.sin(0.3 * time + each)),
        received=np.floor(40.0 * time + each),
        lost=np.floor(0.4 * time * (each % 3)),
        available={"hold": (armed, "all vehicles stop"), "rewind": (time > 40.0, "goes back")},
        time_left=24.0 if plan.phase_at(float(time)).name == "grab" else None,
        remaining=plan.duration - float(time),
    )


def events(plan: Plan) -> list[Event]:
    """Return a handful of events of that flight."""
    found = [Event(phase.start, "phase", f"{phase.name} begins") for phase in plan.phases]
    start = plan.phase("grab").start
    found += [
        Event(start + 1.0 + i, "command", f"gripper closed on vehicle {i + 1}", i + 1)
        for i in range(plan.vehicles)
    ]
    found.append(Event(47.0, "warning", "vehicle 4 lags by 0.09 m: the clock slows to 0.4", 4))
    return sorted(found, key=lambda event: event.time)


def _places(corners: Floats, lengths: Floats) -> Floats:
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    x = along - along[-1] / 2
    line = np.column_stack([x, np.full_like(x, -8.0), np.zeros_like(x)])
    close = line * np.array([0.88, 1.0, 1.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack(
        [
            line - np.array([0.0, 2.0, 0.0]),
            line + 3.0 * up,
            line,
            close,
            close + 6.0 * up,
            corners,
            corners,
            corners + up,
            corners * np.array([1.6, 1.6, 0.0]),
        ]
    )


def _path(corners: Floats, lanes: Floats, cell: float) -> Floats:
    pieces = []
    for a, b, lane in zip(corners[:-1], corners[1:], lanes, strict=True):
        share = np.linspace(0.0, 1.0, 30)[:, None]
        near = np.minimum(share, 1 - share) * np.linalg.norm(b - a) / (0.6 * cell)
        pieces.append(a + share * (b - a) + np.clip(near, 0.0, 1.0) * [0.0, 0.0, lane])
    return np.concatenate(pieces)
