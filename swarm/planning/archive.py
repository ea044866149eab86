"""Plans as data: JSON and NumPy arrays, and plan files made of both.

Reading executes no code: files hold numbers and text only. The digests in a plan file protect from
accidental changes alone, because who can change a file can change its digests too.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from swarm.errors import InputError, Problem, shown
from swarm.files import parse_json
from swarm.folding.layout import KnotLayout
from swarm.geometry.motion import Motion
from swarm.mission import Mission
from swarm.mission.validation import validate
from swarm.planning.digest import digest
from swarm.planning.plan import Gate, KnotSummary, Phase, Plan
from swarm.planning.ranges import length_problems, motion_problems, place_problems
from swarm.version import __version__

READ_ERRORS: Final = (
    KeyError, TypeError, ValueError, AttributeError, OSError, EOFError, zipfile.BadZipFile,
    zlib.error, NotImplementedError, RuntimeError, OverflowError, MemoryError,
)  # fmt: skip
"""Exceptions that the libraries raise for damaged JSON and .npz files."""

_TYPES: Final[Mapping[str, TypeAdapter[Any]]] = {
    "knot": TypeAdapter(KnotSummary),
    "phases": TypeAdapter(list[Phase]),
    "gates": TypeAdapter(list[Gate]),
    "notes": TypeAdapter(list[str]),
}

FORMAT: Final = "swarm plan"
SCHEMA: Final = 2
"""Name and version of the format of plan files, as in their manifest. 1 had no certificate."""

_MANIFEST, _DOCUMENT, _MOTION = "manifest.json", "plan.json", "motion.npz"
_CERTIFICATE = "certificate.json"
_LARGEST_MEMBER = 256 * 1024 * 1024
"""Bytes that a member of a plan file may have: a damaged file must not fill the memory."""
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
    """Return a plan's motion as the bytes of an .npz file; compressed, it would be 8 % smaller."""
    buffer = io.BytesIO()
    np.savez(buffer, times=plan.motion.times, coefficients=plan.motion.coefficients)
    return buffer.getvalue()


def read_plan(
    document: Mapping[str, Any], motion: bytes, source: str = "the record's plan"
) -> Plan:
    """Return the plan of a document and a motion; ``source`` names them in errors.

    Raises :class:`InputError` where they do not describe a plan.
    """
    try:
        layout = document["layout"]
        for key, kind in _TYPES.items():
            _require_type(kind, key, document[key])
        plan = Plan(
            mission=validate(Mission, document["mission"], f"{source}: mission"),
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
            path=np.array(document["path"] if document["path"] != [] else np.empty((0, 3)), float),
            notes=tuple(document["notes"]),
        )
        _require_shapes(plan)
        problems = _range_problems(plan, source)
    except READ_ERRORS as error:
        raise InputError(f"{source} cannot be read: {error}") from None
    if problems:
        raise InputError(problems)
    return plan


def _range_problems(plan: Plan, source: str) -> list[Problem]:
    """Times, places and lengths of a plan that are out of range."""
    start, end = plan.motion.times[[0, -1]].tolist()
    return [
        *motion_problems(plan.motion, f"{source}: motion"),
        *length_problems(plan.layout.lengths.tolist(), f"{source}: layout.lengths"),
        *place_problems(plan.layout.corners, f"{source}: layout.corners"),
        *place_problems(plan.path, f"{source}: path"),
        *(
            Problem(f"{source}: {key}", f"expected {start:g} to {end:g} s, got {time:g} s")
            for key, times in (
                ("gates", [gate.time for gate in plan.gates]),
                ("phases", [time for phase in plan.phases for time in (phase.start, phase.end)]),
            )
            for time in times
            if not start <= time <= end
        ),
    ]


def _require_type(kind: TypeAdapter[Any], key: str, value: Any) -> None:
    """Raise ValueError for a value of another type; its numbers are kept as they are written."""
    try:
        kind.validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in (key, *first["loc"]))
        raise ValueError(f"{place}: {first['msg']}, got {shown(first['input'])}") from None


def _require_shapes(plan: Plan) -> None:
    """Raise ValueError where the arrays of a plan do not belong to one team and one cable."""
    layout, vehicles, segments = plan.layout, plan.vehicles, len(plan.layout.lengths)
    if segments not in {0, vehicles - 1}:
        raise ValueError(f"{segments} segments between {vehicles} vehicles")
    for name in ("sags", "lengths", "lanes"):
        if (
            getattr(layout, name).shape != (segments,)
            or not np.isfinite(getattr(layout, name)).all()
        ):
            raise ValueError(f"layout.{name}: expected {segments} finite numbers")
    if layout.corners.shape != (vehicles, 3) or plan.path.ndim != 2 or plan.path.shape[1] != 3:
        raise ValueError("layout.corners or path: expected rows of three numbers")
    if not all(0 <= segment < segments for pair in layout.crossings for segment in pair):
        raise ValueError("layout.crossings: a segment that does not exist")


def _read_motion(data: bytes) -> Motion:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        sizes = [info.file_size for info in arrays.zip.infolist()]
        if sum(sizes) > _LARGEST_MEMBER:
            raise ValueError("the motion is too large")
        times = np.asarray(arrays["times"], dtype=np.float64)
        coefficients = np.asarray(arrays["coefficients"], dtype=np.float64)
    pieces = len(times) - 1
    shape = coefficients.shape
    if times.ndim != 1 or len(shape) != 4 or shape[:2] != (pieces, 6) or shape[3] != 3:
        raise ValueError("the motion has a wrong shape")
    if not (np.isfinite(times).all() and np.isfinite(coefficients).all()):
        raise ValueError("the motion has numbers that are not finite")
    if pieces < 1:
        raise ValueError("the motion has no piece")
    return Motion(times, coefficients)


@dataclass(frozen=True, eq=False)
class PlanFile:
    """The content of a plan file: the plan, and the document of its certificate.

    The document is what the file states, not yet compared with the plan; None in a file without.
    ``checks`` names the program that computed it; None in files of programs before that key.
    """

    plan: Plan
    certificate: Mapping[str, Any] | None
    checks: str | None = None


def plan_file(
    plan: Plan, certificate: Mapping[str, Any] | None = None, checks: str | None = None
) -> bytes:
    """Return a plan as one file: a ZIP archive of JSON documents and the motion.

    ``certificate`` is the document of its certificate, as a flight record has it, and ``checks``
    the name of the program that computed it. The manifest holds the format's name and version, the
    version of the program, that name, the plan's digest, and the SHA-256 of the other members.
    Floats are kept to the last bit; equal plans give equal bytes.
    """
    members = {_DOCUMENT: _json(plan_document(plan)), _MOTION: plan_motion(plan)}
    if certificate is not None:
        members[_CERTIFICATE] = _json(certificate)
    manifest = {
        "format": FORMAT,
        "schema": SCHEMA,
        "swarm": __version__,
        **({} if checks is None else {"checks": checks}),
        "digest": digest(plan),
        "sha256": {name: _sha256(data) for name, data in members.items()},
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {_MANIFEST: _json(manifest), **members}.items():
            kind = zipfile.ZIP_STORED if name == _MOTION else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), data, kind)
    return buffer.getvalue()


def read_plan_file(data: bytes, source: str) -> PlanFile:
    """Return the content of bytes from :func:`plan_file`; ``source`` names them in errors.

    Raises :class:`InputError` for another kind of file, an incomplete file, another version of the
    format, and a file that was changed.
    """
    manifest = _read_manifest(_members(data, source, [_MANIFEST])[_MANIFEST], source)
    sums = manifest["sha256"]
    names = [_DOCUMENT, _MOTION, *([_CERTIFICATE] if _CERTIFICATE in sums else [])]
    members = _members(data, source, names)
    for name in names:
        _require(f"{source}: SHA-256 of {name}", sums.get(name), _sha256(members[name]))
    document = _document(members[_DOCUMENT], f"{source}: {_DOCUMENT}")
    plan = read_plan(document, members[_MOTION], f"{source}: the plan")
    _require(f"{source}: digest", manifest["digest"], digest(plan))
    if _CERTIFICATE not in members:
        return PlanFile(plan, None)
    certificate = _document(members[_CERTIFICATE], f"{source}: {_CERTIFICATE}")
    return PlanFile(plan, certificate, manifest.get("checks"))


def _read_manifest(data: bytes, source: str) -> Mapping[str, Any]:
    """Return a manifest of this version of the format."""
    try:
        manifest = parse_json(data, source)
        kind, schema = manifest["format"], manifest["schema"]
        dict(manifest.get("sha256", {}))
    except (*READ_ERRORS, InputError):
        raise InputError([Problem(f"{source}: {_MANIFEST}", "cannot be read")]) from None
    _require(f"{source}: format", FORMAT, kind)
    if schema != SCHEMA or isinstance(schema, bool):
        maker = f"swarm {manifest['swarm']}" if "swarm" in manifest else "another version of swarm"
        message = f"expected {SCHEMA}, got {schema}: made by {maker}, whose plan files differ"
        raise InputError([Problem(f"{source}: schema", message)])
    if not isinstance(manifest.get("sha256"), dict) or "digest" not in manifest:
        raise InputError([Problem(f"{source}: {_MANIFEST}", "cannot be read")])
    mapping: Mapping[str, Any] = manifest
    return mapping


def _document(data: bytes, place: str) -> Any:
    return parse_json(data, place)


def _json(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, indent=1, allow_nan=False).encode()


def _members(data: bytes, source: str, names: Sequence[str]) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {}
            for name in names:
                with archive.open(name) as member:
                    members[name] = member.read(_LARGEST_MEMBER + 1)
    except KeyError as error:
        message = f"expected a plan file, got an archive without {error.args[0]}"
        raise InputError([Problem(source, message)]) from None
    except READ_ERRORS as error:
        message = f"expected a plan file, got another or incomplete file ({error})"
        if data.lstrip()[:1] == b"{" and b'"fileType"' in data:
            message = "expected a plan file of swarm plan --save, got a plan of QGroundControl"
        raise InputError([Problem(source, message)]) from None
    large = [name for name, read in members.items() if len(read) > _LARGEST_MEMBER]
    if large:
        message = f"expected at most {_LARGEST_MEMBER:,} bytes"
        raise InputError([Problem(f"{source}: {name}", message) for name in large])
    return members


def _require(place: str, expected: object, got: object) -> None:
    if type(expected) is not type(got) or expected != got:
        raise InputError([Problem(place, f"expected {expected}, got {got}")])


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
