"""Flights, records and fetched logs as JSON-ready objects; lengths in metres, times in seconds."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from swarm.certification.assessment import Assessment
from swarm.exports import tightest_object
from swarm.flight.result import FlightResult, adherence_object
from swarm.flight.swinging import flown_swing, swing_object
from swarm.flight.tlog import Replayed
from swarm.ground.commissioning.survey import LogDownload
from swarm.ground.record_verification import VerifiedRecord
from swarm.planning import Plan
from swarm.verification import Verification


def outcome_object(
    plan: Plan, result: FlightResult, verification: Verification, assessment: Assessment
) -> dict[str, Any]:
    """Return the outcome of a flight of a plan, with flown beside certified distances."""
    statistics = result.statistics
    lateness, latency = statistics.lateness, statistics.command_latency
    return {
        "outcome": result.outcome.word,
        "explanation": result.outcome.explanation,
        "record": str(result.record) if result.record else None,
        "certificate": {**asdict(result.basis), "description": result.basis.words},
        "adherence": adherence_object(result.adherence),
        **verification_object(verification, assessment),
        "swing": swing_object(flown_swing(plan, result.trace)),
        "duration": statistics.duration,
        "setpoints": statistics.setpoints,
        "setpoint_gap": {"seconds": statistics.gap[0], "at": statistics.gap[1]},
        "setpoint_lateness": {"median": lateness[0], "p99": lateness[1]} if lateness else None,
        "cpu_load": statistics.cpu,
        "command_latency": {"median": latency[0], "max": latency[1]} if latency else None,
        "packets_lost": {str(system): count for system, count in statistics.lost.items()},
    }


def verification_object(verification: Verification, assessment: Assessment) -> dict[str, Any]:
    """Return the implied knot, flown beside certified distances, and the tracking errors."""
    return {
        "knot": {
            "type": verification.knot,
            "chirality": verification.chirality,
            "gauss": verification.gauss,
            "as_planned": verification.as_planned,
        },
        "clearance": {
            name: {
                "flown": tightest_object(flown) if flown else None,
                "certified": tightest_object(assessment.distances[name]),
            }
            for name, flown in verification.distances.items()
        },
        "max_chord_ratio": verification.max_chord_ratio,
        "tracking_error": [
            {
                "phase": error.phase,
                "vehicle": error.vehicle,
                "rms": error.rms,
                "p999": error.p999,
                "max": error.largest,
            }
            for error in verification.tracking
        ],
        "notes": list(verification.notes),
    }


def record_object(verified: VerifiedRecord) -> dict[str, Any]:
    """Return the verification of a record, its link statistics and its observations."""
    return {
        "record": str(verified.record),
        "certificate": asdict(verified.basis) if verified.basis else None,
        "adherence": adherence_object(verified.adherence) if verified.adherence else None,
        **verification_object(verified.verification, verified.assessment),
        **_link_statistics(verified.log),
        "observations": [asdict(observation) for observation in verified.observations],
    }


def _link_statistics(log: Replayed) -> dict[str, Any]:
    return {
        "systems": list(log.known.systems),
        "commands": [
            {
                "name": command.name,
                "sent": command.sent,
                "acknowledged": command.answered,
                "resent": command.repeated,
                "latency": {"median": command.median, "max": command.largest}
                if command.answered
                else None,
            }
            for command in log.commands
        ],
        "links": {
            str(system): {
                "packets_received": log.received[system],
                "packets_lost": log.lost[system],
            }
            for system in log.known.systems
        },
        "damaged_packets": log.damaged,
        "log_notes": list(log.notes),
    }


def logs_object(logs: Sequence[LogDownload]) -> dict[str, Any]:
    """Return the logs that were fetched from the autopilots."""
    return {
        "logs": [
            {
                "system": log.system,
                "path": str(log.path) if log.path else None,
                "size": log.size or None,
                "date": log.date or None,
                "problem": log.problem or None,
            }
            for log in logs
        ]
    }
