"""Simulated flights of a plan, and the verification of flight records."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm import planning
from swarm.certification.certificate import Certificate, CertifiedPlan
from swarm.certification.distances import Tightest
from swarm.errors import Refused
from swarm.flight.result import FlightResult, Word
from swarm.flight.trace import Trace
from swarm.front.recordings import Recording
from swarm.ground.record_verification import VerifiedRecord, verify_record
from swarm.knots.names import describe_knot
from swarm.mission.fleet import Fleet
from swarm.notebook import table
from swarm.simulation.loop import Fault, simulate_flight
from swarm.verification import Verification, verify_trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class Flight:
    """A simulated flight: its ``plan``, the ``result``, and its ``verification``.

    Returned by :func:`swarm.simulate`. Source: :mod:`swarm.simulation.loop` (the flight software
    against the emulator) and :mod:`swarm.verification` (implied knot and distances).
    """

    plan: planning.Plan
    result: FlightResult
    verification: Verification

    @property
    def outcome(self) -> Word:
        """The outcome: "done", "refused", "failed" or "interrupted"."""
        return self.result.outcome.word

    @property
    def explanation(self) -> str:
        """The reason of the outcome."""
        return self.result.outcome.explanation

    @property
    def knot(self) -> str:
        """The knot that the last reported positions of the hold imply, such as "3_1 right-handed".

        "unknown" without such positions. Implied by the cable model is not observed.
        """
        return describe_knot(self.verification.knot, self.verification.chirality)

    @property
    def as_planned(self) -> bool:
        """Whether the implied crossings are those of the layout, and the knot that of the plan."""
        return self.verification.as_planned

    @property
    def clearance(self) -> Mapping[str, Tightest | None]:
        """The smallest distances at reported positions, or of setpoints, in the cable model.

        At the moments to which the certificate applies. "cable" between strands, surface to
        surface; "vehicle" between vehicles; "vehicle_cable" between a vehicle and segments that it
        does not hold, and others, one per kind of clearance: metres, with mission time and the
        names of the two bodies. None without two such bodies.
        """
        return self.verification.distances

    @property
    def tracking_error(self) -> float | None:
        """The largest reported distance in metres of a grip point from its setpoint.

        With cable: while it is lifted or aloft, for comparison with the certificate. Without cable:
        of the whole flight. None without reported positions.
        """
        if len(self.plan.layout.lengths):
            return self.result.adherence.largest
        error = np.linalg.norm(self.trace.position - self.trace.setpoint, axis=-1)
        return float(np.nanmax(error)) if np.isfinite(error).any() else None

    @property
    def within_certificate(self) -> bool:
        """Whether the certificate holds for every reported tracking error."""
        return self.result.adherence.within

    @property
    def trace(self) -> Trace:
        """Reported positions and setpoints (k, n, 3), ENU metres, over time (k,) in seconds."""
        return self.result.trace

    def plot(self) -> "Figure":
        """Return a matplotlib figure: the cable in the hold, tracking errors, the mission clock.

        Source: :func:`swarm.reports.plots.flight_figure`.
        """
        from swarm.reports.plots import flight_figure  # noqa: PLC0415 - slow to import

        return flight_figure(self.plan, self.trace)

    def view(self, path: str | os.PathLike[str] | None = None) -> Recording:
        """Write flight and plan side by side as a Rerun recording and open it, as ``Plan.view``.

        Raises :class:`swarm.InputError` where the file cannot be written.
        Source: :func:`swarm.view.replay.write_flight`.
        """
        from swarm.view.replay import write_flight  # noqa: PLC0415 - slow to import

        return Recording.written(
            lambda file: write_flight(self.plan, self.trace, self.result.events, file), path
        )

    def __repr__(self) -> str:
        return f"<Flight {self.plan.mission.name}: {', '.join(self._figures().values())}>"

    def _repr_html_(self) -> str:
        return table(f"Flight {self.plan.mission.name}", self._figures().items())

    def _figures(self) -> dict[str, str]:
        """Return the key figures of the flight by name."""
        figures: dict[str, str] = {"outcome": self.outcome}
        if self.outcome != "done":
            figures["reason"] = self.explanation
        if self.plan.knot.type:
            figures["knot"] = f"{self.knot}{'' if self.as_planned else ' (not as planned)'}"
        if self.tracking_error is not None:
            figures["tracking error"] = f"tracking error {self.tracking_error:.2f} m"
        if not self.within_certificate:
            figures["certificate"] = "outside its certificate"
        return figures


def flyable(plan: planning.Plan, certificate: Certificate) -> CertifiedPlan:
    """Return a plan with its certificate; raises :class:`Refused` where it cannot be flown."""
    if not any(gate.condition == "armed" for gate in plan.gates):
        raise Refused(
            "an external trajectory can be certified, not flown: it has no gates at which vehicles "
            "arm, grip and settle"
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

    The same ``seed`` gives the same flight. ``fleet`` is an emulated fleet, by default of PX4
    vehicles (:func:`swarm.mission.fleet.emulated_fleet`). ``faults`` are injected during the flight
    (:class:`swarm.simulation.loop.Fault`). ``world`` replaces the emulator's world that the plan
    expects (`swarm schema world`).

    A flight that does not end as planned is returned too, with its ``outcome``.
    Raises :class:`swarm.Refused` where the certificate belongs to another plan or has errors, where
    the fleet does not fit the plan, and for an external trajectory, which has no gates at which
    vehicles arm, grip and settle.

    Source: :func:`swarm.simulation.loop.simulate_flight`, :func:`swarm.verification.verify_trace`.
    """
    flight_plan = flyable(plan, certificate)
    result = simulate_flight(flight_plan, fleet=fleet, seed=seed, faults=faults, world=world)
    return Flight(plan, result, verify_trace(plan, result.trace))


def verify(record: str | os.PathLike[str]) -> VerifiedRecord:
    """Verify a flight ``record``, the folder that `swarm fly` leaves.

    Compares reported positions and sent setpoints, from the .tlog, with the recorded plan:
    ``.verification`` has the implied knot, the smallest distances and the tracking errors;
    ``.adherence`` compares the largest tracking error with the certified one; ``.observations`` are
    by persons and cameras; ``.log`` has the trace and the statistics of the links. ``.passed`` is
    the verdict of `swarm verify`.

    Raises :class:`swarm.InputError` for a folder that is not a complete record.

    Source: :func:`swarm.ground.record_verification.verify_record`.
    """
    return verify_record(Path(record))
