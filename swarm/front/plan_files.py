"""Plan files with a certificate: written after a review, read again before a flight.

What a file states about its plan is never taken as a certificate: the checks are computed again
from the plan in the file. A file of this program is refused where they do not agree with it. The
checks of another version may differ, so its file is read as a plan, and what differs is said.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from swarm import jit
from swarm.certification.assessment import Assessment
from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.certification.kinds import FIGURES
from swarm.certification.minima import TOLERANCE
from swarm.errors import InputError, Problem
from swarm.files import read_bytes
from swarm.flight.archive import certificate_document, read_certificate
from swarm.flight.flight_plan import basis_of, max_tracking_error
from swarm.planner import PlanningResult, certify_again
from swarm.planning import digest
from swarm.planning.archive import plan_file, read_plan_file
from swarm.version import __version__

Progress = Callable[[str, float], None]

LARGEST_PLAN = 512 * 1024 * 1024
"""Bytes of a plan file; an hour of a hundred vehicles takes less."""


def checks() -> str | None:
    """Return a name for the sources and tables of all checks; None where they are not known.

    They are not where a file has changed since this process started.
    """
    tables = Path(__file__).parents[1] / "knots"
    try:
        digest_of_sources = hashlib.sha256(jit.program(__file__).encode())
        for table in sorted(tables.glob("*.txt")):
            digest_of_sources.update(table.read_bytes())
    except OSError:
        return None
    return digest_of_sources.hexdigest()[:16]


def certified_plan_file(certified: CertifiedPlan) -> bytes:
    """Return a certified plan and its certificate as the bytes of a plan file."""
    plan = certified.plan
    basis = basis_of(certified, cable=bool(len(plan.layout.lengths)))
    return plan_file(plan, certificate_document(basis, certified.assessment), checks())


def load_certified(
    path: str | os.PathLike[str], progress: Progress | None = None
) -> tuple[PlanningResult, str]:
    """Read a plan file with a certificate, and compute its certificate again.

    Returns and raises as :func:`read_certified`.
    """
    return read_certified(read_bytes(path, LARGEST_PLAN), os.fspath(path), progress)


def read_certified(
    data: bytes, source: str, progress: Progress | None = None
) -> tuple[PlanningResult, str]:
    """Return the plan of bytes from :func:`certified_plan_file`, certified again.

    For a file of this program, the recorded e* and w* are shown to hold again. For a file of
    another version of it they are computed anew, and the second value is a notice of what differs
    from the file's certificate; it is empty otherwise. ``source`` names the file in messages.

    Raises :class:`InputError` for another, incomplete or changed file, for one without a
    certificate, and where the recorded certificate is not of the recorded plan, the plan is not
    cleared, or a certificate of this program is not the one that is computed.
    """
    file = read_plan_file(data, source)
    place = f"{source}: certificate.json"
    if file.certificate is None:
        message = "expected a plan file with its certificate, as `swarm plan --save` writes it"
        raise InputError([Problem(source, message)])
    basis, recorded = read_certificate(file.certificate, place)
    name = digest(file.plan)
    if (basis.kind, basis.digest) != ("certified", name):
        message = f"expected that of this plan ({name}), got {basis.kind} ({basis.digest})"
        raise InputError([Problem(place, message)])
    ours = file.checks is not None and file.checks == checks()
    most = max_tracking_error(file.plan, recorded)
    if ours and basis.max_tracking_error != most:
        message = f"expected {most:g}, the larger of e* and vehicles.tracking, got "
        message += f"{basis.max_tracking_error}"
        raise InputError([Problem(f"{place}: max_tracking_error", message)])
    planned = certify_again(file.plan, recorded.robustness if ours else None, progress)
    if not planned.certificate.cleared:
        errors = [each for each in planned.assessment.findings if each.severity == "error"]
        raise InputError([Problem(f"{place}: {each.check}", each.message) for each in errors])
    differences = list(_differences(recorded, planned.assessment, file.certificate))
    if not ours:
        return planned, _notice(differences, source)
    if differences:
        raise InputError([Problem(f"{place}: {each.key}", each.refusal) for each in differences])
    return planned, ""


class _Difference(NamedTuple):
    """A key of a certificate with its value as computed again, and as the file states it."""

    key: str
    computed: object
    stated: object

    @property
    def refusal(self) -> str:
        if self.key.startswith("robustness"):
            return f"expected a value for which the plan is certified, got {self.stated}"
        if self.computed == "none":
            return f"got {self.stated}, which the checks do not find"
        return f"expected {self.computed}, as computed again, got {self.stated}"


def _notice(differences: list[_Difference], source: str) -> str:
    """Return what is said of a file of another version, whose figures do not count."""
    lines = [
        f"{source}: certified by another version of the program; all checks were computed again "
        f"by this one ({__version__}), and only their results count"
    ]
    lines += [
        f"  {key}: {computed} as computed again, {stated} in the file"
        for key, computed, stated in differences
        if str(computed) != str(stated)
    ]
    return "\n".join(lines if len(lines) > 1 else [*lines, "  no figure differs"])


def _differences(
    recorded: Assessment, computed: Assessment, document: Mapping[str, Any]
) -> Iterator[_Difference]:
    """Yield what a recorded certificate states otherwise than the certificate of its plan."""
    if document.get("cleared") is not True:
        yield _Difference("cleared", "true", document.get("cleared"))
    for key in ("knot", "chirality", "gauss"):
        expected, got = getattr(computed, key), getattr(recorded, key)
        if expected != got:
            yield _Difference(f"knot.{'type' if key == 'knot' else key}", expected, got)
    for key in FIGURES:
        expected, got = (each.distances[key].distance for each in (computed, recorded))
        # The resolution of the search; another processor may round differently.
        if expected != got and not abs(expected - got) <= TOLERANCE:
            yield _Difference(f"clearance.{key}.distance", f"{expected:.4f}", f"{got:.4f}")
        expected, got = (each.distances[key].required for each in (computed, recorded))
        if expected != got:
            yield _Difference(f"clearance.{key}.required", expected, got)
    for key in ("tracking", "wind"):
        expected, got = (getattr(each.robustness, key) for each in (computed, recorded))
        if expected != got:
            yield _Difference(f"robustness.{key}", _number(expected), _number(got))
    expected, got = _checks(computed.findings), _checks(recorded.findings)
    for missing in sorted((expected - got).elements()):
        yield _Difference("findings", missing, "none")
    for other in sorted((got - expected).elements()):
        yield _Difference("findings", "none", other)


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:g}"


def _checks(findings: tuple[Finding, ...]) -> Counter[str]:
    """Return severity and check of all findings; their words may be of another version."""
    return Counter(f"{each.severity} {each.check}" for each in findings)
