"""The digest that identifies a plan: its motion, cable and limits."""

import hashlib
import json
from dataclasses import asdict

import numpy as np

from swarm.planning.plan import Plan

_VERSION = b"swarm plan 1\n"


def digest(plan: Plan) -> str:
    """Return the SHA-256 of all data of a plan that a check reads, as 64 hexadecimal digits.

    It covers every bit of the motion, the layout with the lengths of the segments, phases, gates,
    the knot and the whole mission (cable, vehicles, clearances, wind, workspace). ``path`` and
    ``notes`` are for readers and do not change it.
    """
    layout = plan.layout
    words = {
        "mission": plan.mission.model_dump(mode="json", by_alias=True),
        "knot": asdict(plan.knot),
        "crossings": [list(pair) for pair in layout.crossings],
        "cell": layout.cell,
        "phases": [asdict(phase) for phase in plan.phases],
        "gates": [asdict(gate) for gate in plan.gates],
    }
    checksum = hashlib.sha256(_VERSION)
    checksum.update(json.dumps(words, sort_keys=True).encode())
    for array in (
        plan.motion.times,
        plan.motion.coefficients,
        layout.corners,
        layout.sags,
        layout.lengths,
        layout.lanes,
    ):
        checksum.update(repr(array.shape).encode())
        checksum.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return checksum.hexdigest()
