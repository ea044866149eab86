"""The test hop of ``swarm check``: its question, its flight, its measurement."""

from dataclasses import dataclass
from pathlib import Path

from swarm.certification.certificate import CertifiedPlan
from swarm.certification.findings import Finding
from swarm.flight.bench_flight import (
    ERROR_LIMIT,
    HEIGHT,
    HOVER,
    Hover,
    hover_findings,
    hovers,
    tracking_to_plan_with,
)
from swarm.flight.flight_plan import CableFreeFlight
from swarm.ground.fly import FlightCallbacks, FlyOptions, fly
from swarm.mission.fleet import Fleet


@dataclass(frozen=True)
class HopResult:
    """The findings of a hop, and the hover errors; none if the vehicles did not hover.

    ``tracking`` is the tracking error to plan with, metres; None where not all were measured.
    """

    findings: tuple[Finding, ...]
    hovers: tuple[Hover, ...] = ()
    tracking: float | None = None


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
    world_clock: Path | None = None,
    rtcm: str | None = None,
    mocap: str | None = None,
    callbacks: FlightCallbacks | None = None,
) -> HopResult:
    """Fly the hop of a plan, see :mod:`swarm.flight.bench_flight`, and return the hover errors.

    The record of the hop goes to ``folder``. ``speed`` is a multiple of real time, for emulated
    fleets only; with the ``world_clock`` of vehicles simulated elsewhere, the hop follows it.
    ``rtcm`` is the address of a source of corrections, ``mocap`` of a motion capture system.
    """
    options = FlyOptions(
        speed=speed,
        no_cable=True,
        audit=False,
        error_limit=ERROR_LIMIT,
        world_clock=world_clock,
        rtcm=rtcm,
        mocap=mocap,
    )
    result = fly(hop_flight, fleet, folder, options, callbacks)
    measured, findings = hovers(result.trace), hover_findings(result.trace, flight_plan)
    if result.outcome.word != "done":
        text = f"the hop ended as {result.outcome.word}: {result.outcome.explanation}"
        findings = [Finding("error", "hop", text), *(findings if measured else ())]
    needed = tracking_to_plan_with(measured, flight_plan.plan.vehicles)
    return HopResult(tuple(findings), measured, needed)
