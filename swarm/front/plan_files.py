"""Plan files with a certificate: written after a review, read again before a flight.

What a file states about its plan is never taken as a certificate. The checks are computed again
from the plan in the file, and the file is refused where they do not agree with it.
"""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from swarm.certification.assessment import Assessment
from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.certification.minima import TOLERANCE
from swarm.errors import InputError, Problem
from swarm.files import read_bytes
from swarm.flight.archive import certificate_document, read_certificate
from swarm.flight.flight_plan import basis_of, max_tracking_error
from swarm.planner import PlanningResult, certify_again
from swarm.planning import digest
from swarm.planning.archive import plan_file, read_plan_file

Progress = Callable[[str, float], None]

LARGEST_PLAN = 512 * 1024 * 1024
"""Bytes of a plan file; an hour of a hundred vehicles takes less."""


def certified_plan_file(certified: CertifiedPlan) -> bytes:
    """Return a certified plan and its certificate as the bytes of a plan file."""
    plan = certified.plan
    basis = basis_of(certified, cable=bool(len(plan.layout.lengths)))
    return plan_file(plan, certificate_document(basis, certified.assessment))


def load_certified(
    path: str | os.PathLike[str], progress: Progress | None = None
) -> PlanningResult:
    """Read a plan file with a certificate, and compute its certificate again.

    Raises :class:`InputError` as :func:`read_certified`.
    """
    return read_certified(read_bytes(path, LARGEST_PLAN), os.fspath(path), progress)


def read_certified(data: bytes, source: str, progress: Progress | None = None) -> PlanningResult:
    """Return the plan of bytes from :func:`certified_plan_file`, certified again.

    The recorded e* and w* are shown to hold again. ``source`` names the file in errors.

    Raises :class:`InputError` for another, incomplete or changed file, for one without a
    certificate, and where the recorded certificate is not the one of the recorded plan.
    """
    found = read_plan_file(data, source)
    place = f"{source}: certificate.json"
    if found.certificate is None:
        message = "expected a plan file with its certificate, as `swarm plan --save` writes it"
        raise InputError([Problem(source, message)])
    basis, recorded = read_certificate(found.certificate, place)
    name = digest(found.plan)
    if (basis.kind, basis.digest) != ("certified", name):
        message = f"expected that of this plan ({name}), got {basis.kind} ({basis.digest})"
        raise InputError([Problem(place, message)])
    most = max_tracking_error(found.plan, recorded)
    if basis.max_tracking_error != most:
        message = f"expected {most:g}, the larger of e* and vehicles.tracking, got "
        message += f"{basis.max_tracking_error}"
        raise InputError([Problem(f"{place}: max_tracking_error", message)])
    planned = certify_again(found.plan, recorded.robustness, progress)
    if not planned.certificate.cleared:
        errors = [one for one in planned.assessment.findings if one.severity == "error"]
        raise InputError([Problem(f"{place}: {one.check}", one.message) for one in errors])
    problems = list(_differences(recorded, planned.assessment, found.certificate, place))
    if problems:
        raise InputError(problems)
    return planned


def _differences(
    recorded: Assessment, computed: Assessment, document: Mapping[str, Any], place: str
) -> Iterator[Problem]:
    """Yield what a recorded certificate states otherwise than the certificate of its plan."""

    def differs(key: str, expected: object, got: object) -> Problem:
        return Problem(f"{place}: {key}", f"expected {expected}, as computed again, got {got}")

    if document.get("cleared") is not True:
        yield differs("cleared", "true", document.get("cleared"))
    for key in ("knot", "chirality", "gauss"):
        expected, got = getattr(computed, key), getattr(recorded, key)
        if expected != got:
            yield differs(f"knot.{'type' if key == 'knot' else key}", expected, got)
    for key in ("cable", "vehicle", "vehicle_cable"):
        expected, got = (getattr(one, key).distance for one in (computed, recorded))
        # The resolution of the search; another processor may round differently.
        if expected != got and not abs(expected - got) <= TOLERANCE:
            yield differs(f"clearance.{key}.distance", f"{expected:.4f}", f"{got:.4f}")
        expected, got = (getattr(one, key).required for one in (computed, recorded))
        if expected != got:
            yield differs(f"clearance.{key}.required", expected, got)
    for key in ("tracking", "wind"):
        expected, got = (getattr(one.robustness, key) for one in (computed, recorded))
        if expected != got:
            yield Problem(
                f"{place}: robustness.{key}",
                f"expected a value for which the plan is certified, got {got:g}",
            )
    expected, got = _checks(computed.findings), _checks(recorded.findings)
    for missing in sorted((expected - got).elements()):
        yield Problem(f"{place}: findings", f"expected {missing}, as computed again, got none")
    for other in sorted((got - expected).elements()):
        yield Problem(f"{place}: findings", f"got {other}, which the checks do not find")


def _checks(findings: tuple[Finding, ...]) -> Counter[str]:
    """Return severity and check of all findings; their words may be of another version."""
    return Counter(f"{one.severity} {one.check}" for one in findings)
