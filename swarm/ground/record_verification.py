"""Verification of a flight record: the recorded plan compared with the logged positions."""

from dataclasses import dataclass, replace
from pathlib import Path

from swarm.certification.assessment import Assessment, assess
from swarm.flight.adherence import Adherence, adherence
from swarm.flight.flight_plan import Basis, confirmed_basis
from swarm.flight.tlog import Replayed
from swarm.ground.observations import Observation, append_observation, recorded_observations
from swarm.ground.record_reader import recorded_basis, recorded_flight, recorded_plan
from swarm.ground.truth_reader import true_trace
from swarm.planning import Plan
from swarm.verification import Verification, verify_trace


@dataclass(frozen=True, eq=False)
class VerifiedRecord:
    """A flight record and its verification.

    ``basis`` and ``adherence`` are None for a record from before certificates. ``log`` has the
    trace and the link statistics of the .tlog, ``truth``: with the emulator's positions.
    ``observations`` are in the order of their entry.
    """

    record: Path
    plan: Plan
    basis: Basis | None
    assessment: Assessment
    log: Replayed
    verification: Verification
    adherence: Adherence | None
    observations: tuple[Observation, ...]
    truth: bool = False

    @property
    def outside_certificate(self) -> bool:
        """Whether cable was carried with a tracking error that is not certified."""
        if self.basis is None or self.adherence is None:
            return False
        return self.basis.cable and not self.adherence.within

    @property
    def passed(self) -> bool:
        """Whether the positions imply the planned knot, within the certificate.

        The last observation, if there is one, must agree.
        """
        agrees = not self.observations or self.observations[-1].agrees(self.plan.knot)
        return self.verification.as_planned and agrees and not self.outside_certificate

    def observed(self, observation: Observation) -> "VerifiedRecord":
        """Append an observation to the record, and return the verification with it.

        Raises :class:`InputError` where the record cannot be written.
        """
        append_observation(self.record, observation)
        return replace(self, observations=(*self.observations, observation))


def verify_record(record: Path, *, truth: bool = False) -> VerifiedRecord:
    """Return the verification of a flight record; of the emulator's ground truth with ``truth``.

    Reads reported positions and sent setpoints from the .tlog, and checks the recorded plan again,
    with the tracking error that its certificate states.
    Raises :class:`InputError` for a folder that is not a complete record.
    """
    plan = recorded_plan(record)
    basis = recorded_basis(record, plan)
    if basis is not None:
        basis = confirmed_basis(plan, basis)
    observations = tuple(recorded_observations(record))
    log = recorded_flight(record, plan)
    if truth:
        log = replace(log, trace=true_trace(record, log))
    return VerifiedRecord(
        record=record,
        plan=plan,
        basis=basis,
        assessment=assess(plan),
        log=log,
        verification=verify_trace(plan, log.trace),
        adherence=adherence(plan, log.trace, basis) if basis else None,
        observations=observations,
        truth=truth,
    )
