"""The test hop of ``swarm check``: its question, its flight, its measurement."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.flight.flight_plan import CableFreeFlight
from swarm.flight.hop import (
    ERROR_LIMIT,
    HEIGHT,
    HOVER,
    Hover,
    hover_findings,
    hovers,
)
from swarm.flight.snapshot import Event, Snapshot
from swarm.ground.fly import fly
from swarm.mission.fleet import Fleet


@dataclass(frozen=True)
class HopResult:
    """The findings of a hop, and the hover errors; none if the vehicles did not hover."""

    findings: tuple[Finding, ...]
    hovers: tuple[Hover, ...] = ()


def hop_question(flight_plan: CertifiedPlan) -> str:
    """Return the question to the operator before a hop of a plan's vehicles."""
    clearance = flight_plan.plan.mission.clearance.vehicle
    return (
        f"Arm {flight_plan.plan.vehicles} vehicles and hover for {HOVER:g} s at {HEIGHT:g} m? "
        f"All land if one is more than {ERROR_LIMIT:g} m off, or two are within {clearance:g} m."
    )


def fly_hop(
    hop_flight: CableFreeFlight,
    flight_plan: CertifiedPlan,
    fleet: Fleet,
    folder: Path,
    *,
    speed: float = 1.0,
    on_snapshot: Callable[[Snapshot], None] | None = None,
    on_event: Callable[[Event], None] | None = None,
) -> HopResult:
    """Fly the hop of a plan, see :func:`swarm.flight.hop.hop`, and return the hover errors.

    The record of the hop goes to ``folder``. ``speed`` is a multiple of real time, for emulated
    fleets only.
    """
    result = fly(
        hop_flight,
        fleet,
        folder,
        speed=speed,
        no_cable=True,
        audit=False,
        on_snapshot=on_snapshot,
        on_event=on_event,
        stray_limit=ERROR_LIMIT,
    )
    measured, found = hovers(result.trace), hover_findings(result.trace, flight_plan)
    if result.outcome.word != "done":
        text = f"the hop ended as {result.outcome.word}: {result.outcome.explanation}"
        found = [Finding("error", "hop", text), *(found if measured else ())]
    return HopResult(tuple(found), measured)
