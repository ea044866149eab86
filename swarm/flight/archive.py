"""Certificates as data: what a record keeps of one, and the certificate's findings read again.

Numbers and words only, read without running anything.
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from math import inf
from typing import Any, get_args

from swarm.certification.assessment import Assessment
from swarm.certification.clearances import MOST_TRACKING, MOST_WIND, Robustness
from swarm.certification.distances import Tightest
from swarm.certification.findings import Finding, Severity
from swarm.certification.kinds import FIGURES
from swarm.errors import InputError, Problem, shown
from swarm.exports import clearance_object, finding_object
from swarm.flight.flight_plan import Basis, Kind
from swarm.mission.mission import LARGEST_TRACKING
from swarm.planning.archive import READ_ERRORS


def certificate_document(basis: Basis, assessment: Assessment) -> dict[str, Any]:
    """Return the basis of a flight, with its findings, as plain data for JSON."""
    return {
        "schema": 1,
        **asdict(basis),
        "cleared": assessment.cleared,
        "knot": {
            "type": assessment.knot,
            "chirality": assessment.chirality,
            "gauss": assessment.gauss,
        },
        "clearance": clearance_object(assessment),
        "robustness": asdict(assessment.robustness),
        "findings": [finding_object(finding) for finding in assessment.findings],
    }


def read_certificate(
    document: Mapping[str, Any], source: str = "the record's certificate"
) -> tuple[Basis, Assessment]:
    """Return the content of a :func:`certificate_document`; ``source`` names it in errors.

    It is what a file states. Only :mod:`swarm.certification.certificate` makes certificates.
    Raises :class:`InputError`.
    """
    try:
        basis = Basis(**{field.name: document[field.name] for field in fields(Basis)})
        if not isinstance(basis.cable, bool) or basis.kind not in get_args(Kind):
            raise ValueError("cable or kind is none of its values")
        _require_range(source, "max_tracking_error", basis.max_tracking_error, LARGEST_TRACKING)
        for name, most in (("tracking", MOST_TRACKING), ("wind", MOST_WIND)):
            recorded = document["robustness"][name]
            _require_range(source, f"robustness.{name}", recorded, most)
        return basis, Assessment(
            findings=tuple(_read_finding(finding) for finding in document["findings"]),
            distances={figure: _read_tightest(document["clearance"][figure]) for figure in FIGURES},
            knot=str(document["knot"]["type"]),
            chirality=document["knot"]["chirality"],
            gauss=str(document["knot"]["gauss"]),
            robustness=Robustness(**document["robustness"]),
        )
    except READ_ERRORS as error:
        raise InputError(f"{source} cannot be read: {error}") from None


def _require_range(source: str, key: str, value: Any, most: float) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if value is not None and not (number and 0.0 <= value <= most):
        message = f"expected null or a number from 0 to {most:g}, got {shown(value)}"
        raise InputError([Problem(f"{source}: {key}", message)])


def _read_finding(document: Mapping[str, Any]) -> Finding:
    # older records have the keys at_time and where
    where = document["position"] if "position" in document else document["where"]
    x, y, z = where if where is not None else (0.0, 0.0, 0.0)
    time = document["time"] if "time" in document else document["at_time"]
    if document["severity"] not in get_args(Severity):
        raise ValueError("a severity that does not exist")
    return Finding(
        document["severity"],
        str(document["check"]),
        str(document["message"]),
        None if time is None else float(time),
        None if where is None else (float(x), float(y), float(z)),
    )


def _read_tightest(document: Mapping[str, Any]) -> Tightest:
    distance, (first, second) = document["distance"], document["between"]
    return Tightest(
        inf if distance is None else float(distance),
        float(document["required"]),
        float(document["time"]),
        (str(first), str(second)),
    )
