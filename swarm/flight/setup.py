"""What a flight never changes: its plan, its fleet, and the values that follow from the two."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm.certification.contingency_windows import ContingencyWindows, contingency_windows
from swarm.certification.monitor import Monitor
from swarm.errors import Refused
from swarm.flight.bench_flight import is_bare
from swarm.flight.flight_plan import Basis, FlightPlan, basis_of
from swarm.flight.load import PlannedPull
from swarm.flight.separation import Separations, separations
from swarm.flight.swinging import SwingEstimator
from swarm.mission.fleet import Fleet
from swarm.planning import Gate, Plan

Floats = npt.NDArray[np.float64]

LOOSE_ERROR = 0.5
"""Metres of tracking error that are allowed while no vehicle holds the cable."""


@dataclass(frozen=True)
class FlightOptions:
    """How a plan is flown.

    ``no_cable``: nothing is attached and grips are simulated. ``open_loop``: the clock keeps the
    planned rate whatever the clearances, the cable's pull and the tracking errors are; for
    comparisons in the emulator alone. ``error_limit`` in metres: tracking errors neither slow nor
    hold the clock in the phase ``hold``; beyond this error, or with too little distance between
    vehicles, all land. ``corrected``: corrections are sent to receivers, and used before take-off.
    """

    no_cable: bool = False
    open_loop: bool = False
    error_limit: float | None = None
    corrected: bool = False


@dataclass(frozen=True, eq=False)
class Setup:
    """One flight's constants.

    ``commands_grippers`` says whether grippers are commanded, ``carries_cable`` whether cable is
    attached, ``bare`` whether the vehicles could not hold one. ``swing`` estimates the swing of the
    cable, where one is folded. ``lift`` (3,) in metres leads from grip points to centres. ``drag``
    is that of the vehicles whose fleet file states it, by system id, 1/s.
    """

    flight_plan: FlightPlan
    plan: Plan
    fleet: Fleet
    options: FlightOptions
    basis: Basis
    commands_grippers: bool
    carries_cable: bool
    bare: bool
    gates: tuple[Gate, ...]
    windows: ContingencyWindows
    separations: Separations
    monitor: Monitor
    swing: SwingEstimator | None
    pull: PlannedPull
    lift: Floats
    drag: Mapping[int, float]


def setup_of(flight_plan: FlightPlan, fleet: Fleet, options: FlightOptions) -> Setup:
    """Return the constants of a flight.

    Raises :class:`Refused` where the fleet is too small, the plan does not rest at its gates, is
    not the one that was checked, or would carry cable that was not checked.
    """
    flight_plan.check()
    plan = flight_plan.plan
    if len(fleet.vehicles) < plan.vehicles:
        raise Refused(
            f"the plan needs {plan.vehicles} vehicles, the fleet {fleet.name} "
            f"has {len(fleet.vehicles)}"
        )
    _check_rest(plan)
    no_cable = options.no_cable
    carries_cable = not no_cable and len(plan.layout.lengths) > 0
    gripper = fleet.gripper == "mavlink" and plan.mission.grab != "attached"
    return Setup(
        flight_plan=flight_plan,
        plan=plan,
        fleet=fleet,
        options=options,
        basis=basis_of(flight_plan, cable=carries_cable),
        commands_grippers=gripper and not no_cable,
        carries_cable=carries_cable,
        bare=is_bare(fleet, no_cable=no_cable),
        gates=tuple(sorted(plan.gates, key=lambda gate: gate.time)),
        windows=contingency_windows(plan, whole=True),
        separations=separations(plan),
        monitor=Monitor(plan),
        swing=SwingEstimator.of(plan) if carries_cable else None,
        pull=PlannedPull(plan),
        lift=np.array([0.0, 0.0, plan.mission.vehicles.grip_offset]),
        drag={listed.sysid: listed.drag for listed in fleet.vehicles if listed.drag is not None},
    )


def _check_rest(plan: Plan) -> None:
    """Raise :class:`Refused` where the plan moves at a gate: the clock stops there at once."""
    for gate in plan.gates:
        _, velocity, acceleration = plan.motion.at(gate.time)
        fastest = float(np.linalg.norm(velocity, axis=1).max())
        strongest = float(np.linalg.norm(acceleration, axis=1).max())
        if not (fastest <= 1e-3 and strongest <= 0.05 and math.isfinite(gate.timeout)):
            raise Refused(
                f"the plan moves at the gate at {gate.time:.2f} s "
                f"({fastest:.3f} m/s, {strongest:.3f} m/s²); it must rest there"
            )
