"""One flight of a plan in the emulator, and what it came to."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm import planning
from swarm.certification.assessment import Tightest
from swarm.certification.certificate import Certificate, CertifiedPlan
from swarm.errors import Refused
from swarm.flight.result import FlightResult, Word
from swarm.flight.trace import Trace
from swarm.front.recordings import Recording
from swarm.knots.names import describe_knot
from swarm.mission.fleet import Fleet
from swarm.notebook import table
from swarm.simulation.loop import Fault, simulate_flight
from swarm.verification import Verification, verify_trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class FlownClearances:
    """The smallest distances at reported positions in fold and hold, in the cable model.

    ``cable`` between strands, surface to surface; ``vehicle`` between vehicles; ``vehicle_cable``
    between vehicles and other segments' cable: metres, with mission time and the two things.
    None where there are no two such things.
    """

    cable: Tightest | None
    vehicle: Tightest | None
    vehicle_cable: Tightest | None


@dataclass(frozen=True, repr=False, eq=False)
class Flight:
    """A simulated flight: its ``plan``, the ``result``, and its ``verification``.

    Made by :func:`swarm.simulate`. Source: :mod:`swarm.simulation.loop` (the flight software
    against the emulator) and :mod:`swarm.verification` (what reported positions imply).
    """

    plan: planning.Plan
    result: FlightResult
    verification: Verification

    @property
    def outcome(self) -> Word:
        """How it ended: "done", "refused", "failed" or "interrupted"."""
        return self.result.outcome.word

    @property
    def explanation(self) -> str:
        """Why it ended so, in words."""
        return self.result.outcome.explanation

    @property
    def knot(self) -> str:
        """The knot that the last positions of the hold imply, such as "3_1 right-handed".

        "unknown" where nothing was reported then. Implied is not observed: in the cable model.
        """
        return describe_knot(self.verification.knot, self.verification.chirality)

    @property
    def as_planned(self) -> bool:
        """Whether the implied crossings are those of the plan's layout, and the knot the plan's."""
        return self.verification.as_planned

    @property
    def clearance(self) -> FlownClearances:
        """The smallest distances that were kept, metres."""
        return FlownClearances(
            self.verification.cable, self.verification.vehicle, self.verification.vehicle_cable
        )

    @property
    def tracking_error(self) -> float | None:
        """The largest distance in metres of a grip point from its setpoint, as reported.

        Of the time in which the cable is lifted or aloft, to be compared with what the certificate
        is for; of the whole flight where no cable is carried. None where nothing was reported.
        """
        if len(self.plan.layout.lengths):
            return self.result.adherence.largest
        error = np.linalg.norm(self.trace.position - self.trace.setpoint, axis=-1)
        return float(np.nanmax(error)) if np.isfinite(error).any() else None

    @property
    def within_certificate(self) -> bool:
        """Whether no tracking error was reported for which the certificate does not hold."""
        return self.result.adherence.within

    @property
    def trace(self) -> Trace:
        """Reported positions and setpoints (k, n, 3), ENU metres, over time (k,) in seconds."""
        return self.result.trace

    def plot(self) -> "Figure":
        """Return a matplotlib figure: where it was held, tracking errors, the mission clock.

        Source: :func:`swarm.reports.plots.flight_figure`.
        """
        from swarm.reports.plots import flight_figure  # noqa: PLC0415 - slow to import

        return flight_figure(self.plan, self.trace)

    def view(self, path: str | os.PathLike[str] | None = None) -> Recording:
        """Write flight and plan side by side as a Rerun recording and open it, as Plan.view does.

        Raises :class:`swarm.InputError` where the file cannot be written.
        Source: :func:`swarm.view.replay.write_flight`.
        """
        from swarm.view.replay import write_flight  # noqa: PLC0415 - slow to import

        return Recording.made(
            lambda file: write_flight(self.plan, self.trace, self.result.events, file), path
        )

    def __repr__(self) -> str:
        return f"<Flight {self.plan.mission.name}: {', '.join(self._figures().values())}>"

    def _repr_html_(self) -> str:
        return table(f"Flight {self.plan.mission.name}", self._figures().items())

    def _figures(self) -> dict[str, str]:
        """What one line says of the flight, by name."""
        figures: dict[str, str] = {"outcome": self.outcome}
        if self.outcome != "done":
            figures["why"] = self.explanation
        if self.plan.knot.type:
            figures["knot"] = f"{self.knot}{'' if self.as_planned else ' (not as planned)'}"
        if self.tracking_error is not None:
            figures["tracking error"] = f"tracking error {self.tracking_error:.2f} m"
        if not self.within_certificate:
            figures["certificate"] = "outside its certificate"
        return figures


def flyable(plan: planning.Plan, certificate: Certificate) -> CertifiedPlan:
    """Return the plan as certified; raises :class:`Refused` where it cannot be flown."""
    if not any(gate.condition == "armed" for gate in plan.gates):
        raise Refused(
            "a motion that others planned is certified, not flown: it has no gates at which "
            "vehicles arm, grip and settle"
        )
    return CertifiedPlan(plan, certificate)


def simulate(
    plan: planning.Plan,
    certificate: Certificate,
    *,
    seed: int = 1,
    fleet: Fleet | None = None,
    faults: Sequence[Fault] = (),
    world: Mapping[str, Any] | None = None,
) -> Flight:
    """Fly a plan in virtual time: the flight software against the emulator, packet by packet.

    The same ``seed`` gives the same flight. ``fleet`` is an emulated one, by default of PX4
    vehicles (:func:`swarm.mission.fleet.emulated_fleet`); ``faults`` are what goes
    wrong during it (:class:`swarm.simulation.loop.Fault`); ``world`` is what the emulator is told
    instead of what the plan expects (`swarm schema world`).

    A flight that does not end as planned is returned, with its ``outcome``.
    Raises :class:`swarm.Refused` where the certificate belongs to another plan or holds errors,
    where the fleet does not fit the plan, and for a :class:`swarm.Motion` of others, which has no
    gates at which vehicles arm, grip and settle.

    Source: :func:`swarm.simulation.loop.simulate_flight`, :func:`swarm.verification.verify_trace`.
    """
    flight_plan = flyable(plan, certificate)
    result = simulate_flight(flight_plan, fleet=fleet, seed=seed, faults=faults, world=world)
    return Flight(plan, result, verify_trace(plan, result.trace))
