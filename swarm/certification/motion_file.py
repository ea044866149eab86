"""External trajectories in the format of ``swarm plan --export``, as a plan to certify."""

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from swarm.errors import InputError, Problem, SwarmError
from swarm.files import parse_json
from swarm.geometry.catenary import sag_for_length
from swarm.geometry.chain import crossing_gaps, plan_crossings
from swarm.geometry.motion import through_states
from swarm.mission import Mission
from swarm.planning import Gate, KnotLayout, KnotSummary, Phase, PhaseName, Plan
from swarm.planning.phase_order import declared_cable, phase_order_error
from swarm.planning.ranges import LARGEST, LATEST, length_problems, time_problems
from swarm.tables import MOST_PROBLEMS, Table, stamp_problem

Floats = npt.NDArray[np.float64]

COLUMNS = ("time", "vehicle", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "phase")

_RELEASE_TIMEOUT = 20.0
"""Seconds at the gate of the release, as in planned flights."""


@dataclass(frozen=True, eq=False)
class MotionFile:
    """States of n grip points at k times: ``time`` (k,), ``states`` (k, n, 9), ``phase`` (k,)."""

    time: Floats
    states: Floats
    phase: tuple[PhaseName, ...]


def read_motion(text: str, source: str) -> MotionFile:
    """Read a motion table: one row per time and vehicle, ENU metres, m/s, m/s² and the phase.

    All vehicles have the same phases, in the order of a flight (:mod:`swarm.planning.phase_order`).
    The order determines when the cable is gripped and released. Raises
    :class:`InputError` with up to MOST_PROBLEMS problems, each with its line.
    """
    table = Table(text, source)
    columns = table.find(_UNITS)
    vehicle_column, phase_column = (columns[COLUMNS.index(word)] for word in _WORDS)
    times: list[float] = []
    phases: list[PhaseName] = []
    rows: list[list[list[float]]] = []
    for line, cells in table:
        known = len(table.problems)
        time, *state = (
            table.number(line, cells, column, name, least, most)
            for name, column, (least, most) in zip(COLUMNS, columns, _RANGES, strict=True)
            if name not in _WORDS
        )
        if stamp := stamp_problem(cells[columns[0]]):
            raise InputError([Problem(table.place(line, columns[0]), f"time: {stamp}")])
        vehicle, phase = _vehicle(cells[vehicle_column]), _phase(cells[phase_column])
        if vehicle is None:
            table.wrong(line, cells, vehicle_column, "vehicle", "1, 2, … along the cable")
        if phase is None:
            names = f"one of {', '.join(get_args(PhaseName))}"
            table.wrong(line, cells, phase_column, "phase", names)
        if len(table.problems) > known or vehicle is None or phase is None:
            continue
        wrong = _phase_problem(phases, phase, vehicle)
        if wrong:
            table.add(Problem(table.place(line, phase_column), f"phase: {wrong}"))
        if vehicle == 1:
            times.append(time)
            phases.append(phase)
            rows.append([])
        if not rows or vehicle != len(rows[-1]) + 1 or time != times[-1]:
            expected = "vehicle 1"
            if rows:
                expected = f"vehicle {len(rows[-1]) + 1} at {times[-1]:g} s or vehicle 1 later"
            message = f"expected {expected}, got {vehicle} at {time:g} s"
            raise InputError([*table.problems, Problem(f"{source}: line {line}", message)])
        rows[-1].append(state)
    table.finish()
    if problems := _shape_problems(source, times, rows):
        raise InputError(problems)
    return MotionFile(np.array(times), np.array(rows), tuple(phases))


_WORDS = ("vehicle", "phase")
_UNITS = dict(zip(COLUMNS, ("s", "", *3 * ["m"], *3 * ["m/s"], *3 * ["m/s2"], ""), strict=True))
_RANGES = ((-LATEST, LATEST), *[(-LARGEST, LARGEST)] * (len(COLUMNS) - 1))


def _vehicle(text: str) -> int | None:
    return int(text) if re.fullmatch(r"[0-9]{1,4}", text) and int(text) else None


def _phase(text: str) -> PhaseName | None:
    return next((known for known in get_args(PhaseName) if text == known), None)


def _phase_problem(phases: list[PhaseName], phase: PhaseName, vehicle: int) -> str | None:
    """The error in a row's phase after the phases so far, if any."""
    if vehicle == 1 and (not phases or phase != phases[-1]):
        return phase_order_error(phases[-1] if phases else None, phase)
    if phases and phase != phases[-1]:
        return f"expected {phases[-1]} as for vehicle 1 at that time, got {phase}"
    return None


def _shape_problems(
    source: str, times: list[float], rows: list[list[list[float]]]
) -> list[Problem]:
    if len(times) < 2:
        return [Problem(source, f"expected at least 2 times, got {len(times)}")]
    if len(rows[0]) < 2:
        return [Problem(source, "expected at least 2 vehicles, got 1")]
    wrong = [
        Problem(source, f"expected {len(rows[0])} vehicles at {time:g} s, got {len(row)}")
        for time, row in zip(times, rows, strict=True)
        if len(row) != len(rows[0])
    ]
    wrong += time_problems(times, source)
    return wrong[:MOST_PROBLEMS]


def read_lengths(text: str, source: str) -> Floats:
    """Read the segments' lengths in metres, in order along the cable.

    JSON: a list, an object with ``segments``, or one with ``cable.segments`` as ``swarm plan
    --json`` prints it. A table: one column of lengths, or a heading with the column ``length``.
    Raises :class:`InputError`.
    """
    values: list[Any]
    if text.lstrip()[:1] in {"[", "{"}:
        values = _listed(text, source)
    else:
        values = _tabulated(Table(text, source))
    wrong = length_problems(values, source)
    if wrong or not values:
        raise InputError(wrong[:MOST_PROBLEMS] or [Problem(source, "expected lengths, got none")])
    return np.array([float(value) for value in values])


def _tabulated(table: Table) -> list[float]:
    """Return the lengths of a table."""
    if table.heading:
        (column,) = table.find({"length": "m"})
    elif table.columns > 1:
        message = f"expected one column of lengths, or a heading with length, got {table.columns} "
        message += "columns; a decimal comma needs semicolons or tabs between columns, or quotes"
        raise InputError([Problem(f"{table.source}: line {table.heading_line}, column 2", message)])
    else:
        column = 0
    values = [table.number(line, cells, column, "", 0.0, LARGEST) for line, cells in table]
    table.finish()
    return values


def _listed(text: str, source: str) -> list[Any]:
    document = parse_json(text, source)
    if isinstance(document, dict) and {"cable", "segments"} <= document.keys():
        raise InputError([Problem(source, "expected segments or cable, got both")])
    if isinstance(document, dict):
        document = document.get("cable", document)
    if isinstance(document, dict):
        document = document.get("segments")
    if not isinstance(document, list):
        message = "expected a list of lengths, or an object with segments or cable.segments"
        raise InputError([Problem(source, message)])
    return document


def plan_of_motion(
    motion: MotionFile, lengths: Floats, mission: Mission, knot: KnotSummary | None = None
) -> Plan:
    """Return external trajectories as a plan, for the same checks.

    Between its rows the motion is the quintic through position, velocity and acceleration. With
    ``knot`` None, no knot is required. Raises :class:`InputError` where the lengths are not one
    fewer than the vehicles, or no row has the cable aloft.
    """
    count = motion.states.shape[1]
    if len(lengths) != count - 1:
        message = f"expected {count - 1} segments for {count} vehicles, got {len(lengths)}"
        raise InputError([Problem("cable", message)])
    phases, gates = _phases(motion, attached=mission.grab == "attached")
    folded = [phase.end for phase in phases if phase.name in {"fold", "hold"}]
    if not folded:
        raise InputError([Problem("phase", "expected rows in the phase fold or hold, got none")])
    position, velocity, acceleration = np.split(motion.states, 3, axis=-1)
    corners = position[int(np.searchsorted(motion.time, max(folded)))]
    return Plan(
        mission=mission,
        knot=knot or KnotSummary("", "none", "", ()),
        layout=_layout(corners, lengths),
        motion=through_states(motion.time, position, velocity, acceleration),
        phases=phases,
        gates=gates,
        path=corners,
    )


def _phases(motion: MotionFile, *, attached: bool) -> tuple[tuple[Phase, ...], tuple[Gate, ...]]:
    """Phases, each up to the first row of the next, and the gate of the release.

    A phase of the last row alone has no duration; it can only mark the release.
    """
    starts = [0] + [
        i for i in range(1, len(motion.phase)) if motion.phase[i] != motion.phase[i - 1]
    ]
    edges = [float(motion.time[i]) for i in starts] + [float(motion.time[-1])]
    names = [motion.phase[start] for start in starts]
    order = declared_cable(names, attached=attached)
    phases = tuple(
        Phase(name, start, end, cable, False)
        for name, (start, end), cable in zip(names, pairwise(edges), order.cable, strict=True)
    )
    gates = []
    if order.held_until < len(names):
        gates.append(Gate(edges[order.held_until], "released", _RELEASE_TIMEOUT, order.inner_first))
    return phases, tuple(gates)


def _layout(corners: Floats, lengths: Floats) -> KnotLayout:
    steps = np.diff(corners, axis=0)
    spans = np.hypot(steps[:, 0], steps[:, 1])
    try:
        sags = sag_for_length(spans, lengths, steps[:, 2])
        pairs = plan_crossings(corners).segments
        gaps = crossing_gaps(corners, lengths, pairs)
        over_first = [
            (int(i), int(j)) if gap > 0 else (int(j), int(i))
            for (i, j), gap in zip(pairs, gaps, strict=True)
        ]
    except SwarmError:
        # Over-stretched, or without identifiable crossings: the assessment reports it.
        sags, over_first = np.zeros_like(lengths), []
    return KnotLayout(corners, sags, lengths, np.zeros_like(lengths), tuple(over_first), 0.0)
