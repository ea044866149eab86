"""Verification of a flight: the implied knot, the smallest distances and the tracking errors.

All follow from reported positions and the quasi-static cable model. Only an observation, by a
person or a camera, shows whether the cable is tied.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.distances import TAUT, Samples, Tightest, segment_name
from swarm.certification.kinds import FIGURES, MEASURED, Flown, measured_distances
from swarm.certification.topology import cable_curve, layout_code, ties_planned_knot
from swarm.errors import SwarmError
from swarm.flight.trace import Trace
from swarm.knots.curve import curve_gauss
from swarm.knots.gauss import same_code
from swarm.knots.invariants import identify_curve
from swarm.planning import Plan

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]
Chirality = Literal["left", "right", "none"]


@dataclass(frozen=True)
class TrackingStatistics:
    """Statistics of the tracking error of a vehicle in a phase, metres.

    ``vehicle`` counts from 1; 0 means all vehicles. ``phase`` is "" for all phases. ``p999`` is the
    99.9th percentile.
    """

    phase: str
    vehicle: int
    rms: float
    p999: float
    largest: float


@dataclass(frozen=True)
class Verification:
    """The implied knot, the smallest distances and the tracking errors of a flight.

    ``knot``, ``chirality`` and ``gauss`` are of the modelled cable at the last reported positions
    of the hold; "unknown" and "" without such positions. ``as_planned`` is true if the knot is that
    of the plan (:func:`swarm.certification.topology.ties_planned_knot`). ``distances``
    are the smallest of each kind of clearance at the moments to which its certificate applies, at
    reported positions or sent setpoints (:attr:`.Kind.flown_by`), with mission times, by their keys
    in files (:data:`swarm.certification.kinds.MEASURED`); None without positions, or without two
    such bodies. ``max_chord_ratio`` is the largest ratio of chord to length of a segment in fold
    and hold.
    """

    knot: str
    chirality: Chirality
    gauss: str
    as_planned: bool
    distances: Mapping[str, Tightest | None]
    max_chord_ratio: float | None
    tracking: tuple[TrackingStatistics, ...]
    notes: tuple[str, ...] = ()


def verify_trace(plan: Plan, trace: Trace) -> Verification:
    """Return the knot that a trace implies, its smallest distances and its tracking errors."""
    phase = np.array(trace.phase, dtype=str)
    known = np.isfinite(trace.position).all(axis=(1, 2))
    knot, chirality, gauss, as_planned, notes = _knot(
        plan, trace.position[known & (phase == "hold")]
    )
    folding = known & np.isin(phase, ["fold", "hold"])
    place, planned = trace.position[folding], phase != ""
    max_chord_ratio = None
    if len(place) and len(plan.layout.lengths):
        chords = np.linalg.norm(np.diff(place, axis=1), axis=-1) / plan.layout.lengths
        max_chord_ratio = float(chords.max())
    return Verification(
        knot=knot,
        chirality=chirality,
        gauss=gauss,
        as_planned=as_planned,
        distances=measured_distances(
            plan,
            Flown(trace.mission_time[planned], trace.position[planned], trace.setpoint[planned]),
        ),
        max_chord_ratio=max_chord_ratio,
        tracking=tracking_errors(trace),
        notes=notes,
    )


def closest_pairs(plan: Plan, position: Floats, *, cable: bool) -> tuple[Tightest, ...]:
    """Return the smallest distances of grip points (n, 3) at one moment: of vehicles and, with
    cable aloft, of strands that share no vehicle, and of vehicles and cable.

    None where the position of a vehicle is not known.
    """
    if not np.isfinite(position).all():
        return ()
    moment = Samples(plan, position[None], np.zeros(1))
    distances = [
        kind.measured(moment)
        for kind in sorted(
            (MEASURED[key] for key in FIGURES), key=lambda kind: kind.when != "always"
        )
        if kind.measured and (cable or kind.when == "always")
    ]
    return tuple(tightest for tightest in distances if tightest is not None)


def _knot(plan: Plan, held: Floats) -> tuple[str, Chirality, str, bool, tuple[str, ...]]:
    if not len(held):
        return "unknown", "none", "", False, ("no positions were reported in the hold",)
    grip_points, lengths = held[-1], plan.layout.lengths
    if not len(lengths):
        return "0_1", "none", "", True, ()
    chords = np.linalg.norm(np.diff(grip_points, axis=0), axis=-1)
    notes = tuple(
        f"the reported ends of {segment_name(int(i))} are {chords[i] / lengths[i]:.1%} of its "
        "length apart"
        for i in np.flatnonzero(chords > TAUT * lengths)
    )
    curve = cable_curve(grip_points, np.maximum(lengths, chords / TAUT))
    try:
        code, knot = curve_gauss(curve), identify_curve(curve)
        as_planned = ties_planned_knot(plan, knot, code)
        if as_planned and not same_code(code, layout_code(plan.layout)):
            notes += ("it is the planned knot, with other crossings in plan view than planned",)
    except SwarmError as error:
        return "unknown", "none", "", False, (*notes, str(error))
    chirality: Chirality = knot.chirality  # type: ignore[assignment]
    return knot.name, chirality, code.signed_text(), as_planned, notes


def tracking_errors(trace: Trace) -> tuple[TrackingStatistics, ...]:
    """Return statistics per phase and vehicle, per phase, per vehicle, and of the whole flight."""
    error = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    phase = np.array(trace.phase, dtype=str)
    statistics = []
    for name in ["", *dict.fromkeys(trace.phase)]:
        rows = error[phase != ""] if name == "" else error[phase == name]
        for vehicle in range(error.shape[1] + 1):
            chosen = rows if vehicle == 0 else rows[:, vehicle - 1]
            values = chosen[np.isfinite(chosen)]
            if len(values):
                rms = float(np.sqrt(np.mean(values**2)))
                p999 = float(np.quantile(values, 0.999))
                statistics.append(TrackingStatistics(name, vehicle, rms, p999, float(values.max())))
    return tuple(statistics)
