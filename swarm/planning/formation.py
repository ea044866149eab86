"""Plans without a knot: formations one after the other, with or without cable."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from swarm.errors import Refused
from swarm.folding.layout import KnotLayout
from swarm.geometry.catenary import sag_for_length
from swarm.geometry.chain import crossing_gaps, plan_crossings
from swarm.geometry.motion import Motion, at_rest, concatenate, leg
from swarm.mission import Formation, Mission
from swarm.planning.phase_motion import usable_acceleration
from swarm.planning.phase_sequence import flight_around_fold, flight_without_cable
from swarm.planning.plan import KnotSummary, Plan

Floats = npt.NDArray[np.float64]

LINE_SHARE = 0.85
"""Distance between vehicles on the lifted line over the length of cable between them."""

_STILL = 1.0
"""Seconds of rest at every formation, in which the strands stop swinging."""


def formation_plan(mission: Mission, formation: Formation) -> Plan:
    """Return the plan of a flight through the mission's formations, before its certification.

    The phase "fold" takes all vehicles from the lifted line to the first formation and then to each
    other one. They move along straight lines, all at once, from rest to rest.

    Raises :class:`swarm.errors.Refused` for vehicles farther apart than the cable between them.
    """
    places = np.array(formation.places, dtype=np.float64)
    lengths = np.array(formation.lengths, dtype=np.float64)
    stops = list(places)
    if len(lengths):
        _refuse_stretched(places, lengths)
        stops.insert(0, _line(places[0], lengths))
    fold = _through(mission, stops)
    if len(lengths):
        flight = flight_around_fold(mission, lengths, fold)
    else:
        flight = flight_without_cable(fold, mission.hold_time)
    return Plan(
        mission=mission,
        knot=KnotSummary("", "none", "", ()),
        layout=_layout(places[-1], lengths),
        motion=flight.motion,
        phases=flight.phases,
        gates=flight.gates,
        path=np.concatenate([stop[-1:] for stop in stops]),
        notes=(f"flies to {len(places)} formations, straight from rest to rest",),
    )


def _refuse_stretched(places: Floats, lengths: Floats) -> None:
    chords = np.linalg.norm(np.diff(places, axis=1), axis=2)
    wrong = [
        f"formation {stop + 1} has vehicles {segment + 1} and {segment + 2} "
        f"{chords[stop, segment]:.2f} m apart, but formation.lengths gives them "
        f"{lengths[segment]:.2f} m of cable"
        for stop, segment in np.argwhere(chords >= lengths)
    ]
    if wrong:
        raise Refused("\n".join(wrong))


def _line(first: Floats, lengths: Floats) -> Floats:
    """Return the level line (n, 3) before the first formation, centred on it."""
    across = first[-1, :2] - first[0, :2]
    size = float(np.linalg.norm(across))
    heading = across / size if size > 1e-6 else np.array([1.0, 0.0])
    along = np.concatenate([[0.0], np.cumsum(LINE_SHARE * lengths)])
    line = np.empty_like(first)
    line[:, :2] = first[:, :2].mean(axis=0) + (along - along.mean())[:, None] * heading
    line[:, 2] = first[:, 2].max()
    return line


def _through(mission: Mission, stops: list[Floats]) -> Motion:
    """Return the motion through the stops, from rest to rest."""
    rests = [at_rest(stops[0], _STILL)]
    for start, end in pairwise(stops):
        # With half of the acceleration, strands of 4 m would swing by 0.12 m.
        rests.append(
            leg(start, end, 0.5 * mission.vehicles.max_speed, 0.4 * usable_acceleration(mission))
        )
        rests.append(at_rest(end, _STILL))
    return concatenate(*rests)


def _layout(corners: Floats, lengths: Floats) -> KnotLayout:
    """Return the layout of the last formation, with the crossings of its segments."""
    step = np.diff(corners, axis=0)[: len(lengths)]
    spans = np.hypot(step[:, 0], step[:, 1])
    pairs: list[tuple[int, int]] = []
    sags = sag_for_length(spans, lengths, step[:, 2]) if len(lengths) else lengths
    if len(lengths) > 1:
        crossing = plan_crossings(corners).segments
        gaps = crossing_gaps(corners, lengths, crossing)
        pairs = [
            (int(a), int(b)) if gap > 0 else (int(b), int(a))
            for (a, b), gap in zip(crossing, gaps, strict=True)
        ]
    return KnotLayout(corners, sags, lengths, np.zeros_like(lengths), tuple(pairs), 0.0)
