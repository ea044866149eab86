"""Tracking errors of a flight against the errors for which it was certified."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from swarm.flight.flight_plan import Basis
from swarm.flight.trace import Trace
from swarm.planning import Plan

_CERTIFIED_PHASES = frozenset({"lifting", "aloft"})
"""States of the cable in which tracking errors count against the certificate."""


@dataclass(frozen=True)
class Adherence:
    """The largest tracking error while the cable is aloft, and the certified one.

    ``largest`` is in metres, by reported positions, of ``vehicle`` (from 1) at ``mission_time``;
    None where no positions are known. ``certified`` is :attr:`Basis.max_tracking_error`.
    """

    largest: float | None
    vehicle: int
    mission_time: float
    planned: float
    certified: float | None

    @property
    def within(self) -> bool:
        """Whether the certificate covers the largest known tracking error."""
        if self.largest is None:
            return True
        return self.certified is not None and self.largest <= self.certified

    @property
    def words(self) -> str:
        """One sentence on the excess over the certified error; "" without an excess."""
        if self.within or self.largest is None:
            return ""
        allowed = "no error was certified"
        if self.certified is not None:
            allowed = f"it was certified for {self.planned:g} m"
            if self.certified > self.planned:
                allowed += f" and would hold up to {self.certified:.3g} m"
        return (
            f"flown outside its certificate: vehicle {self.vehicle} was {self.largest:.2f} m off "
            f"its setpoint at {self.mission_time:.1f} s of the plan; {allowed}"
        )


def adherence_object(kept: Adherence) -> dict[str, Any]:
    """Return the adherence to the certificate as a JSON-ready object."""
    return {**asdict(kept), "within": kept.within, "words": kept.words}


def adherence(plan: Plan, trace: Trace, basis: Basis) -> Adherence:
    """Compare a flight's trace with the errors for which it was certified."""
    planned = plan.mission.vehicles.tracking
    error = np.linalg.norm(trace.position - trace.setpoint, axis=-1)
    aloft = np.array(
        [
            name != "" and plan.phase_at(time).cable in _CERTIFIED_PHASES
            for name, time in zip(trace.phase, trace.mission_time.tolist(), strict=True)
        ],
        dtype=np.bool_,
    )
    error = np.where(aloft[:, None] & np.isfinite(error), error, -1.0)
    if not error.size or error.max() < 0.0:
        return Adherence(None, 0, 0.0, planned, basis.max_tracking_error)
    row, vehicle = np.unravel_index(int(np.argmax(error)), error.shape)
    return Adherence(
        largest=float(error[row, vehicle]),
        vehicle=int(vehicle) + 1,
        mission_time=float(trace.mission_time[row]),
        planned=planned,
        certified=basis.max_tracking_error,
    )
