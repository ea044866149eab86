"""Snapshots and events as lines of JSON, for the screens of a flight in other processes."""

import json
from dataclasses import asdict
from typing import Any, get_origin, get_type_hints

import numpy as np

from swarm.certification.monitor import Clearances
from swarm.flight.snapshot import Event, Snapshot

_TUPLES = {name for name, hint in get_type_hints(Snapshot).items() if get_origin(hint) is tuple}


def screen_line(item: Snapshot | Event) -> bytes:
    """Return a snapshot or an event as a line of JSON; numbers may be NaN."""
    kind = "event" if isinstance(item, Event) else "snapshot"
    return json.dumps({kind: asdict(item)}, default=np.ndarray.tolist).encode() + b"\n"


def read_screen_line(line: bytes) -> Snapshot | Event | str:
    """Return what a line holds: a snapshot, an event, or the answer to a request.

    Raises :class:`ValueError` for JSON that is neither snapshot nor event.
    """
    if not line.startswith(b"{"):
        return line.decode("utf-8", "replace").strip()
    try:
        ((kind, content),) = json.loads(line).items()
        return Event(**content) if kind == "event" else _snapshot(content)
    except (TypeError, KeyError, AttributeError, ValueError) as error:
        raise ValueError(f"expected a snapshot or an event: {error}") from None


def _snapshot(content: dict[str, Any]) -> Snapshot:
    """Return a snapshot with its arrays, tuples and distances, from the values of its fields."""
    clearances = content.pop("clearances")
    available = {name: tuple(answer) for name, answer in content.pop("available").items()}
    values: dict[str, Any] = {
        name: value
        if not isinstance(value, list)
        else tuple(value)
        if name in _TUPLES
        else np.array(value, dtype=np.float64)
        for name, value in content.items()
    }
    return Snapshot(
        clearances=None if clearances is None else Clearances(**clearances),
        available=available,
        **values,
    )
