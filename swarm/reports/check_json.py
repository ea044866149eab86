"""The result of a ground check as a JSON-ready object; battery and loss as shares, times in s."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from swarm.exports import finding_object
from swarm.ground.commissioning.check import CheckReport, VehicleAudit
from swarm.ground.hop import HopResult


def check_object(
    report: CheckReport, hop: HopResult | None, folder: Path, measured: Path | None = None
) -> dict[str, Any]:
    """Return the go/no-go list, vehicles, links, findings and the hover errors of a check.

    ``measured`` is the fleet file with the tracking error of the hop.
    """
    return {
        "go": report.passed,
        "checklist": [
            {"check": item.check, "subject": item.subject, "go": item.go, "message": item.message}
            for item in report.checklist()
        ],
        "vehicles": [_vehicle(vehicle) for vehicle in report.vehicles],
        "links": [
            {
                "system": link.system,
                "rate": link.rate,
                "longest_gap": link.longest_gap,
                "unanswered": link.unanswered,
                "loss": link.loss,
                "round_trip": link.round_trip if link.round_trip >= 0.0 else None,
            }
            for link in report.links
        ],
        "parameters_set": list(report.parameters_set),
        "order": list(report.order),
        "findings": [finding_object(finding) for finding in report.findings],
        "record": str(folder),
        "hop": hop_object(hop) if hop else None,
        "measured_fleet": str(measured) if measured else None,
    }


def hop_object(hop: HopResult) -> dict[str, Any]:
    """Return the hover errors of a hop, and the tracking error to plan with, in metres."""
    return {
        "recommended_tracking": hop.tracking,
        "vehicles": [asdict(hover) for hover in hop.hovers],
    }


def _vehicle(vehicle: VehicleAudit) -> dict[str, Any]:
    return {
        "system": vehicle.system,
        "firmware": vehicle.firmware,
        "health": dict(vehicle.health),
        "battery": vehicle.battery if vehicle.battery >= 0.0 else None,
        "problems": list(vehicle.problems),
        "parameters": [
            {
                "name": row.name,
                "value": row.value,
                "expected": row.words,
                "reason": row.why,
                "severity": row.severity,
            }
            for row in (*vehicle.deviations, *vehicle.correct)
        ],
    }
