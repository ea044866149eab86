"""Plans as data: JSON and NumPy arrays, and plan files made of both.

Reading executes no code: files hold numbers and text only.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from swarm.errors import InputError, Problem
from swarm.folding.layout import KnotLayout
from swarm.geometry.motion import Motion
from swarm.mission import Mission
from swarm.planning.digest import digest
from swarm.planning.plan import Gate, KnotSummary, Phase, Plan

READ_ERRORS: Final = (
    KeyError, TypeError, ValueError, AttributeError, OSError, EOFError, zipfile.BadZipFile,
    zlib.error, NotImplementedError, RuntimeError,
)  # fmt: skip
"""Exceptions that the libraries raise for damaged JSON and .npz files."""

FORMAT: Final = "swarm plan"
SCHEMA: Final = 1
"""Name and version of the format of plan files, as in their manifest."""

_MANIFEST, _DOCUMENT, _MOTION = "manifest.json", "plan.json", "motion.npz"
_LARGEST_MEMBER = 256 * 1024 * 1024
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Modification time of every member of a plan file, so that equal plans give equal files."""


def plan_document(plan: Plan) -> dict[str, Any]:
    """Return a plan without its motion, as plain data for JSON."""
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


def read_plan(
    document: Mapping[str, Any], motion: bytes, source: str = "the record's plan"
) -> Plan:
    """Return the plan of a document and a motion; ``source`` names them in errors.

    Raises :class:`InputError` where they do not describe a plan.
    """
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
            layout=KnotLayout(
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
    except READ_ERRORS as error:
        raise InputError(f"{source} cannot be read: {error}") from None


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


def plan_file(plan: Plan) -> bytes:
    """Return a plan as one file: a ZIP archive of a manifest, a JSON document and the motion.

    The manifest holds the format's name and version, the plan's digest, and the SHA-256 of the
    other members. Equal plans give equal bytes.
    """
    members = {
        _DOCUMENT: json.dumps(plan_document(plan), indent=1, allow_nan=False).encode(),
        _MOTION: plan_motion(plan),
    }
    manifest = {
        "format": FORMAT,
        "schema": SCHEMA,
        "digest": digest(plan),
        "sha256": {name: _sha256(data) for name, data in members.items()},
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {_MANIFEST: json.dumps(manifest, indent=1).encode(), **members}.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def read_plan_file(data: bytes, source: str) -> Plan:
    """Return the plan of bytes from :func:`plan_file`; ``source`` names them in errors.

    Raises :class:`InputError` for another kind of file, an incomplete file, another version of the
    format, and a file that was changed.
    """
    members = _members(data, source)
    try:
        manifest = json.loads(members[_MANIFEST])
        kind, schema = manifest["format"], manifest["schema"]
        recorded, sums = manifest["digest"], dict(manifest["sha256"])
    except READ_ERRORS:
        raise InputError([Problem(f"{source}: {_MANIFEST}", "cannot be read")]) from None
    _require(f"{source}: format", FORMAT, kind)
    _require(f"{source}: schema", SCHEMA, schema)
    for name in (_DOCUMENT, _MOTION):
        _require(f"{source}: SHA-256 of {name}", sums.get(name), _sha256(members[name]))
    try:
        document = json.loads(members[_DOCUMENT])
    except READ_ERRORS as error:
        raise InputError([Problem(f"{source}: {_DOCUMENT}", f"not JSON: {error}")]) from None
    plan = read_plan(document, members[_MOTION], f"{source}: the plan")
    _require(f"{source}: digest", recorded, digest(plan))
    return plan


def _members(data: bytes, source: str) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            found = {}
            for name in (_MANIFEST, _DOCUMENT, _MOTION):
                with archive.open(name) as member:
                    found[name] = member.read(_LARGEST_MEMBER + 1)
    except KeyError as error:
        message = f"expected a plan file, got an archive without {error.args[0]}"
        raise InputError([Problem(source, message)]) from None
    except READ_ERRORS as error:
        message = f"expected a plan file, got another or incomplete file ({error})"
        raise InputError([Problem(source, message)]) from None
    large = [name for name, read in found.items() if len(read) > _LARGEST_MEMBER]
    if large:
        message = f"expected at most {_LARGEST_MEMBER:,} bytes"
        raise InputError([Problem(f"{source}: {name}", message) for name in large])
    return found


def _require(place: str, expected: object, got: object) -> None:
    if type(expected) is not type(got) or expected != got:
        raise InputError([Problem(place, f"expected {expected}, got {got}")])


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
