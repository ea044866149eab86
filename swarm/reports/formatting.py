"""Words, numbers, times and events: the same in texts, pictures and pages."""

import math
from collections.abc import Iterable, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from swarm.certification.assessment import Assessment, rounded_down
from swarm.certification.findings import numbers
from swarm.certification.kinds import MEASURED, SWINGING
from swarm.flight.snapshot import Event
from swarm.planning import Plan

DISTANCES: Final = {
    **{key: kind.words for key, kind in MEASURED.items()},
    **{key: f"{kind.words}, emulated" for key, kind in SWINGING.items()},
}
"""Distances of flights and of trials, in words."""

ROUTINE_KINDS: Final = frozenset(
    {"discovered", "mode", "armed", "disarmed", "airborne", "landed", "done", "interval", "phase"}
)
"""Kinds of events of every flight that are in the record, but not among those on the screen."""

STATUS_TEXT_KINDS: Final = frozenset({"text", "text warning", "text error"})
"""Kinds of events with a vehicle's STATUSTEXT: notices and less, warnings, errors and worse."""

ERROR_KINDS: Final = frozenset({"failure", "failed", "refused", "rebooted", "error", "text error"})
MERGE_TIME: Final = 5.0
"""Seconds within which the same event of several vehicles becomes one line."""

WARNING_KINDS: Final = frozenset(
    {"hold", "land", "link", "origin", "warning", "timeout", "text warning"}
)


def log_level(event: Event) -> Literal["ERROR", "WARN", "INFO"]:
    """Return the level of an event in a log."""
    if event.kind in ERROR_KINDS:
        return "ERROR"
    if event.kind == "outcome" and not event.message.startswith("done"):
        return "ERROR"
    return "WARN" if event.kind in WARNING_KINDS else "INFO"


def event_text(event: Event, others: Sequence[int] = ()) -> str:
    """Return an event's message, with its vehicle and ``others`` where it does not name them."""
    vehicles = sorted({*([] if event.vehicle is None else [event.vehicle]), *others})
    if not vehicles or (len(vehicles) == 1 and f"vehicle {vehicles[0]}" in event.message):
        return event.message
    return f"vehicle{'s' if len(vehicles) > 1 else ''} {numbers(vehicles)}: {event.message}"


def merge_events(events: Iterable[Event]) -> list[tuple[Event, list[int]]]:
    """Return each event with the other vehicles that have the same event soon after."""
    merged: list[tuple[Event, list[int]]] = []
    for event in events:
        for first, others in reversed(merged):
            if event.time - first.time > MERGE_TIME:
                merged.append((event, []))
                break
            same = (first.kind, first.message) == (event.kind, event.message)
            if same and event.vehicle is not None and first.vehicle is not None:
                others.append(event.vehicle)
                break
        else:
            merged.append((event, []))
    return merged


def together(names: Sequence[str]) -> str:
    """Return two numbered things in words: ``segments 3 and 5``, or ``vehicle 9 and segment 2``."""
    (kind, first), (other, second) = (name.rsplit(" ", 1) for name in names)
    return f"{kind}s {first} and {second}" if kind == other else " and ".join(names)


def metres(value: float | None) -> str:
    """Return a length in metres with two decimals; a dash where it is unknown."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.2f} m"


def certified(value: float | None) -> str:
    """Return a certified length, rounded down: there is at least as much. A dash if unknown."""
    return _at_least(value, 2, "m")


def certified_wind(value: float | None) -> str:
    """Return a certified wind, rounded down as :func:`certified`."""
    return _at_least(value, 1, "m/s")


def _at_least(value: float | None, decimals: int, unit: str) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{rounded_down(value, decimals):.{decimals}f} {unit}"


def seconds(value: float) -> str:
    """Return a time in seconds with one decimal; a dash where it is unknown."""
    return f"{value:.1f} s" if math.isfinite(value) else "–"


def clock(value: float) -> str:
    """Return seconds as minutes and seconds (``1:05.2``), with a sign if negative."""
    tenths = round(abs(value) * 10)
    sign = "-" if value < 0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths % 600 / 10:04.1f}"


def worst_vehicles(
    errors: npt.NDArray[np.float64], link_age: npt.NDArray[np.float64], rows: int
) -> list[int]:
    """Return the indices of the vehicles to list in at most ``rows`` rows, in cable order.

    Silent vehicles come first, by their time of silence, then those with the largest tracking
    errors. One row is left for the number of the others.
    """
    if len(errors) <= rows:
        return list(range(len(errors)))
    silent = np.where(link_age <= 1.0, 0.0, np.nan_to_num(link_age, nan=np.inf))
    order = np.lexsort((np.nan_to_num(errors, nan=np.inf), silent))[::-1]
    return sorted(int(i) for i in order[: rows - 1])


def number(value: float | None) -> str:
    """Return a number with two decimals; a dash where there is none."""
    return "–" if value is None else f"{value:.2f}"


def came_to(kind: str, distance: float, required: float) -> str:
    """Return a distance that is smaller than the required one, in words."""
    return f"{DISTANCES[kind]} came to {distance:.2f} m, {required:.2f} m are required"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural where it is not one."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def capitalized(text: str) -> str:
    """Return a text with its first letter in upper case; the others stay as they are."""
    return text[:1].upper() + text[1:]


def knot_in_words(name: str, chirality: str) -> str:
    """Return a knot's name with its chirality."""
    if not name:
        return "no knot"
    return name if chirality == "none" else f"{name}, {chirality}-handed"


def plan_figures(plan: Plan, assessment: Assessment) -> list[tuple[str, object]]:
    """Return the key figures of a plan with their names."""
    robustness = assessment.robustness
    return [
        ("vehicles", plan.vehicles),
        ("cable", metres(float(plan.layout.lengths.sum()))),
        ("fold", seconds(plan.phase("fold").duration)),
        ("from take-off to the ground", seconds(plan.flight_duration)),
        ("tracking error certified for", metres(plan.mission.vehicles.tracking)),
        ("largest tracking error e*", certified(robustness.tracking)),
        ("largest steady wind w*", certified_wind(robustness.wind)),
    ]
