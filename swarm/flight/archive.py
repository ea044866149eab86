"""Plans as data: what a record keeps of a plan, and the plan made from it again.

Numbers and words only, read without running anything.
"""

import io
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any
from zipfile import BadZipFile

import numpy as np

from swarm.errors import InputError
from swarm.mission import Mission
from swarm.plans import Gate, KnotSummary, Layout, Phase, Plan
from swarm.trajectory import Motion

_UNREADABLE = (
    KeyError, TypeError, ValueError, AttributeError, OSError, EOFError, BadZipFile, zlib.error,
    NotImplementedError, RuntimeError,
)  # fmt: skip
"""What damaged JSON and .npz files raise in the libraries that read them."""
_LARGEST_MEMBER = 256 * 1024 * 1024


def plan_document(plan: Plan) -> dict[str, Any]:
    """Return everything of a plan but its motion, as plain data for JSON."""
    layout = plan.layout
    return {
        "schema": 1,
        "mission": plan.mission.model_dump(mode="json", by_alias=True),
        "knot": asdict(plan.knot),
        "layout": {
            "corners": layout.corners.tolist(),
            "sags": layout.sags.tolist(),
            "lengths": layout.lengths.tolist(),
            "lanes": layout.lanes.tolist(),
            "crossings": [list(pair) for pair in layout.crossings],
            "cell": layout.cell,
        },
        "phases": [asdict(phase) for phase in plan.phases],
        "gates": [asdict(gate) for gate in plan.gates],
        "path": plan.path.tolist(),
        "notes": list(plan.notes),
    }


def plan_motion(plan: Plan) -> bytes:
    """Return a plan's motion as the bytes of an .npz file."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, times=plan.motion.times, coefficients=plan.motion.coefficients)
    return buffer.getvalue()


def read_plan(document: Mapping[str, Any], motion: bytes) -> Plan:
    """Return the plan of a record; raises :class:`InputError` where it is not one."""
    try:
        layout = document["layout"]
        return Plan(
            mission=Mission.model_validate(document["mission"]),
            knot=KnotSummary(
                **{
                    **document["knot"],
                    "grid_columns": tuple(tuple(c) for c in document["knot"]["grid_columns"]),
                }
            ),
            layout=Layout(
                corners=np.array(layout["corners"], dtype=np.float64),
                sags=np.array(layout["sags"], dtype=np.float64),
                lengths=np.array(layout["lengths"], dtype=np.float64),
                lanes=np.array(layout["lanes"], dtype=np.float64),
                crossings=tuple((int(a), int(b)) for a, b in layout["crossings"]),
                cell=float(layout["cell"]),
            ),
            motion=_read_motion(motion),
            phases=tuple(Phase(**phase) for phase in document["phases"]),
            gates=tuple(Gate(**gate) for gate in document["gates"]),
            path=np.array(document["path"], dtype=np.float64),
            notes=tuple(document["notes"]),
        )
    except _UNREADABLE as error:
        raise InputError(f"the record's plan cannot be read: {error}") from None


def _read_motion(data: bytes) -> Motion:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        sizes = [info.file_size for info in arrays.zip.infolist()]
        if sum(sizes) > _LARGEST_MEMBER:
            raise ValueError("the motion is too large")
        times = np.asarray(arrays["times"], dtype=np.float64)
        coefficients = np.asarray(arrays["coefficients"], dtype=np.float64)
    pieces = len(times) - 1
    if times.ndim != 1 or coefficients.ndim != 4 or coefficients.shape[:2] != (pieces, 6):
        raise ValueError("the motion has a wrong shape")
    if not (np.isfinite(times).all() and np.isfinite(coefficients).all()):
        raise ValueError("the motion has numbers that are not finite")
    return Motion(times, coefficients)
