"""The test hop of ``swarm check``: asked for, flown, and what it measured."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.flight.hop import (
    ERROR_LIMIT,
    HEIGHT,
    HOVER,
    Hover,
    hop,
    hover_findings,
    hovers,
    tracking_to_plan_with,
)
from swarm.ground.fly import fly
from swarm.mission.fleet import Fleet
from swarm.reports.terminal import FlightScreen


@dataclass(frozen=True)
class Hopped:
    """What came of a hop; ``measured`` is empty where it was not flown, or not that far."""

    findings: tuple[Finding, ...]
    measured: tuple[Hover, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return what was measured as one JSON-ready object, metres and seconds."""
        return {
            "tracking_to_plan_with": tracking_to_plan_with(self.measured),
            "vehicles": [asdict(one) for one in self.measured],
        }


def fly_hop(
    flight_plan: CertifiedPlan,
    fleet: Fleet,
    folder: Path,
    speed: float,
    console: Console,
    *,
    yes: bool,
) -> Hopped:
    """Fly the hop of a plan's vehicles, after asking; its record goes to ``folder``.

    ``speed`` is for emulated fleets only, which are not asked for.
    """
    clearance = flight_plan.plan.mission.clearance.vehicle
    words = (
        f"Arm {flight_plan.plan.vehicles} vehicles and hover for {HOVER:g} s at {HEIGHT:g} m? "
        f"All land where one is more than {ERROR_LIMIT:g} m off, or two are within {clearance:g} m."
    )
    asks = fleet.emulated is None and not yes
    if asks and not (sys.stdin.isatty() and click.confirm(words, err=True)):
        return Hopped((Finding("warning", "hop", "not flown: not confirmed"),))
    flown = hop(flight_plan)
    with FlightScreen(flown.plan, console) as screen:
        result = fly(
            flown,
            fleet,
            folder,
            speed=speed,
            no_cable=True,
            audit=False,
            on_snapshot=screen.show,
            on_event=screen.event,
            stray_limit=ERROR_LIMIT,
        )
    measured, found = hovers(result.trace), hover_findings(result.trace, flight_plan)
    if result.outcome.word != "done":
        text = f"the hop ended as {result.outcome.word}: {result.outcome.explanation}"
        found = [Finding("error", "hop", text), *(found if measured else ())]
    return Hopped(tuple(found), measured)
