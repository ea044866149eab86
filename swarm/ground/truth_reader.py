"""Ground truth in a flight record: the emulator's world instead of the vehicles' reports."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swarm.errors import InputError, Problem
from swarm.files import parse_json, read_bytes
from swarm.flight.tlog import Replayed
from swarm.flight.trace import Trace
from swarm.mission.validation import LARGEST_FILE

TRUTH = "truth.jsonl"
"""Name of the file in a record; the emulator writes it, `swarm fly --firmware` asks it to."""
LARGEST_TRUTH = 1 << 30
"""Bytes of that file."""


def true_trace(record: Path, flown: Replayed) -> Trace:
    """Return the trace of a flight with true grip points (ENU, metres) for the reported ones.

    Flight time is the world's, from the moment in the record on. Moments without truth are NaN.
    Raises :class:`InputError` for a record without truth of its vehicles.
    """
    path = record / TRUTH
    moments = [moment for moment in _lines(path) if "position" in moment]
    if len(moments) < 2:
        raise InputError([Problem(str(path), "expected the ground truth of an emulated flight")])
    ids = list(moments[0]["ids"])
    missing = [system for system in flown.systems if system not in ids]
    if missing:
        message = (
            f"expected vehicles {', '.join(map(str, missing))}, got {', '.join(map(str, ids))}"
        )
        raise InputError([Problem(str(path), message)])
    rows = [ids.index(system) for system in flown.systems]
    start, world_start = _clock(record)
    time = np.array([moment["time"] for moment in moments])
    at = time - world_start + start - flown.started
    places = np.array([moment["position"] for moment in moments])[:, rows]
    trace = flown.trace
    true = np.full(trace.position.shape, np.nan)
    known = (trace.time >= at[0]) & (trace.time <= at[-1])
    for k in range(len(rows)):
        for axis in range(3):
            true[known, k, axis] = np.interp(trace.time[known], at, places[:, k, axis])
    return replace(trace, position=true)


def _lines(path: Path) -> list[dict[str, Any]]:
    """Return the objects of the file; a last line that was cut off is left out."""
    lines = read_bytes(path, LARGEST_TRUTH).splitlines()
    found = []
    for number, line in enumerate(lines, start=1):
        try:
            found.append(parse_json(line, str(path)))
        except InputError:
            if number < len(lines):
                raise InputError([Problem(f"{path}:{number}", "expected ground truth")]) from None
    return found


def _clock(record: Path) -> tuple[float, float]:
    """Return the wall clock's and the world's time at which flight time was zero, seconds."""
    path = record / "versions.json"
    try:
        facts = parse_json(read_bytes(path, LARGEST_FILE), str(path))
        return float(facts["start_time"]), float(facts["world_start"])
    except (ValueError, KeyError, TypeError):
        raise InputError([Problem(str(path), "expected start_time and world_start")]) from None
