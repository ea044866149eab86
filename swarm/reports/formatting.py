"""Numbers as people read them, the same on screens, in pictures and in reports."""

import math
from collections.abc import Iterable, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from swarm.flight.snapshot import Event
from swarm.flight.words import numbers

ROUTINE: Final = frozenset(
    {"discovered", "mode", "armed", "disarmed", "airborne", "landed", "done", "interval"}
)
"""Kinds of events that every vehicle has in every flight: for the record, not for the screen."""

TEXTS: Final = frozenset({"text", "text warning", "text error"})
"""Kinds of events that are a vehicle's own words: notices and less, warnings, errors and worse."""

ALARMING: Final = frozenset({"failure", "failed", "refused", "rebooted", "error", "text error"})
SAME_WITHIN: Final = 5.0
"""Seconds within which the same words of several vehicles are one line."""

NOTABLE: Final = frozenset({"hold", "land", "link", "origin", "warning", "timeout", "text warning"})


def level(event: Event) -> Literal["ERROR", "WARN", "INFO"]:
    """Return how much attention an event asks for."""
    if event.kind in ALARMING:
        return "ERROR"
    if event.kind == "outcome" and not event.message.startswith("done"):
        return "ERROR"
    return "WARN" if event.kind in NOTABLE else "INFO"


def sentence(event: Event, others: Sequence[int] = ()) -> str:
    """Return an event's words with the vehicles that they are about, if they do not say so."""
    vehicles = sorted({*([] if event.vehicle is None else [event.vehicle]), *others})
    if not vehicles or (len(vehicles) == 1 and f"vehicle {vehicles[0]}" in event.message):
        return event.message
    return f"vehicle{'s' if len(vehicles) > 1 else ''} {numbers(vehicles)}: {event.message}"


def merged(events: Iterable[Event]) -> list[tuple[Event, list[int]]]:
    """Return events with the other vehicles of which the same was said soon after."""
    found: list[tuple[Event, list[int]]] = []
    for event in events:
        for first, others in reversed(found):
            if event.time - first.time > SAME_WITHIN:
                found.append((event, []))
                break
            same = (first.kind, first.message) == (event.kind, event.message)
            if same and event.vehicle is not None and first.vehicle is not None:
                others.append(event.vehicle)
                break
        else:
            found.append((event, []))
    return found


def metres(value: float) -> str:
    """Return a length in metres with two decimals; a dash where it is unknown."""
    return f"{value:.2f} m" if math.isfinite(value) else "–"


def seconds(value: float) -> str:
    """Return a time in seconds with one decimal; a dash where it is unknown."""
    return f"{value:.1f} s" if math.isfinite(value) else "–"


def clock(value: float) -> str:
    """Return seconds as minutes and seconds (``1:05.2``), with a sign before zero."""
    tenths = round(abs(value) * 10)
    sign = "-" if value < 0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths % 600 / 10:04.1f}"


def clip_rows(
    errors: npt.NDArray[np.float64], link_age: npt.NDArray[np.float64], most: int
) -> list[int]:
    """Return which vehicles to list when there is room for ``most``, in order along the cable.

    Those not heard for longest go first, then those with the largest errors.
    """
    if len(errors) <= most:
        return list(range(len(errors)))
    silent = np.where(link_age <= 1.0, 0.0, np.nan_to_num(link_age, nan=np.inf))
    order = np.lexsort((np.nan_to_num(errors, nan=np.inf), silent))[::-1]
    return sorted(int(i) for i in order[: most - 1])


def number(value: float | None, unknown: str = "–") -> str:
    """Return a number with two decimals; ``unknown`` where there is none."""
    return unknown if value is None else f"{value:.2f}"


def number_with_unit(value: float | None, unit: str) -> str:
    """Return a number with two decimals and its unit; a dash where there is none."""
    return "–" if value is None else f"{value:.2f} {unit}"
