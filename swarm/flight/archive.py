"""Plans as data: what a record keeps of a plan and its certificate, and both made from it again.

Numbers and words only, read without running anything.
"""

import io
import zlib
from collections.abc import Mapping
from dataclasses import asdict, fields
from math import inf
from typing import Any, get_args
from zipfile import BadZipFile

import numpy as np

from swarm.errors import InputError
from swarm.exports import finding_object, tightest_object
from swarm.flight.flight_plan import Basis, Kind
from swarm.mission import Mission
from swarm.plans import Gate, KnotSummary, Layout, Phase, Plan
from swarm.preflight.findings import Assessment, Finding, Robustness, Tightest
from swarm.trajectory import Motion

_UNREADABLE = (
    KeyError, TypeError, ValueError, AttributeError, OSError, EOFError, BadZipFile, zlib.error,
    NotImplementedError, RuntimeError,
)  # fmt: skip
"""What damaged JSON and .npz files raise in the libraries that read them."""
_CLEARANCES = ("cable", "vehicle", "vehicle_cable")
_LARGEST_MEMBER = 256 * 1024 * 1024


def plan_document(plan: Plan) -> dict[str, Any]:
    """Return everything of a plan but its motion, as plain data for JSON."""
    layout = plan.layout
    return {
        "schema": 1,
        "mission": plan.mission.document(),
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


def certificate_document(basis: Basis, found: Assessment) -> dict[str, Any]:
    """Return on what a flight is flown, and what the checks found, as plain data for JSON."""
    return {
        "schema": 1,
        **asdict(basis),
        "cleared": found.cleared,
        "knot": {"type": found.knot, "chirality": found.chirality, "gauss": found.gauss},
        "clearance": {name: tightest_object(getattr(found, name)) for name in _CLEARANCES},
        "robustness": asdict(found.robustness),
        "findings": [finding_object(finding) for finding in found.findings],
    }


def read_certificate(document: Mapping[str, Any]) -> tuple[Basis, Assessment]:
    """Return what :func:`certificate_document` wrote; raises :class:`InputError` otherwise."""
    try:
        basis = Basis(**{field.name: document[field.name] for field in fields(Basis)})
        if not isinstance(basis.cable, bool) or basis.kind not in get_args(Kind):
            raise ValueError("cable or kind is none of its values")
        return basis, Assessment(
            findings=tuple(_read_finding(finding) for finding in document["findings"]),
            cable=_read_tightest(document["clearance"]["cable"]),
            vehicle=_read_tightest(document["clearance"]["vehicle"]),
            vehicle_cable=_read_tightest(document["clearance"]["vehicle_cable"]),
            knot=str(document["knot"]["type"]),
            chirality=document["knot"]["chirality"],
            gauss=str(document["knot"]["gauss"]),
            robustness=Robustness(**document["robustness"]),
        )
    except _UNREADABLE as error:
        raise InputError(f"the record's certificate cannot be read: {error}") from None


def _read_finding(document: Mapping[str, Any]) -> Finding:
    where = document["where"]
    x, y, z = where if where is not None else (0.0, 0.0, 0.0)
    return Finding(
        document["severity"],
        str(document["check"]),
        str(document["message"]),
        document["at_time"],
        None if where is None else (float(x), float(y), float(z)),
    )


def _read_tightest(document: Mapping[str, Any]) -> Tightest:
    distance, (one, other) = document["distance"], document["between"]
    return Tightest(
        inf if distance is None else float(distance),
        float(document["required"]),
        float(document["time"]),
        (str(one), str(other)),
    )


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
