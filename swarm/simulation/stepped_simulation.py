"""A simulated flight that is advanced step by step and can be copied in mid-air.

Objects that share memory share it in the copy, too.
"""

import copy
import copyreg
import functools
import json
import struct
import types
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from pymavlink.dialects.v20 import common

from swarm.certification.certificate import CertifiedPlan
from swarm.flight.conductor import Conductor
from swarm.flight.parameters import plan_requirements, rules
from swarm.flight.world import emulated_world
from swarm.mission.fleet import Fleet, emulated_fleet
from swarm.simulation.loop import Emulator, Simulation, parse_world

T = TypeVar("T")

# A decoder's compiled layouts cannot be copied; they are created again.
copyreg.pickle(struct.Struct, lambda one: (struct.Struct, (one.format,)))


def branch(root: T, shared: Iterable[object] = ()) -> T:
    """Return a deep copy of ``root``; ``shared`` objects, which never change, are not copied.

    ``copy.deepcopy`` makes an array of its own of every view. Here a view of an array, and a
    memoryview, becomes the same view of that array's copy.
    """
    memo: dict[int, Any] = {id(part): part for part in shared}
    arrays = [part for part in _parts(root, set(memo)) if isinstance(part, np.ndarray | memoryview)]
    owners: dict[int, Any] = {}
    for part in arrays:
        owner = _owner(part)
        if owner is part:
            continue
        if id(owner) not in owners:
            owners[id(owner)] = memo.setdefault(id(owner), owner.copy(order="K"))
        memo[id(part)] = _same_view(part, owner, owners[id(owner)])
    return copy.deepcopy(root, memo)


def _owner(array: Any) -> Any:
    """Return the array that owns the memory of a view, or of an array itself."""
    if isinstance(array, memoryview):
        array = array.obj
    while isinstance(getattr(array, "base", None), np.ndarray):
        array = array.base
    return array


def _same_view(view: Any, owner: Any, copied: Any) -> Any:
    """Return the view of ``copied`` that corresponds to ``view`` of ``owner``."""
    if isinstance(view, memoryview):
        return memoryview(copied).cast(view.format)  # type: ignore[call-overload]
    offset = view.__array_interface__["data"][0] - owner.__array_interface__["data"][0]
    flat = np.ndarray(copied.nbytes, np.uint8, copied)
    return np.ndarray(view.shape, view.dtype, flat.data, offset, view.strides)


def _parts(root: object, seen: set[int]) -> Iterator[object]:
    """Yield all objects that a deep copy of an object copies, once."""
    waiting = [root]
    while waiting:
        part = waiting.pop()
        if id(part) in seen or isinstance(part, _ATOMS):
            continue
        seen.add(id(part))
        yield part
        if isinstance(part, dict):
            waiting += part.keys()
            waiting += part.values()
        elif isinstance(part, list | tuple | set | frozenset | deque):
            waiting += part
        elif isinstance(part, types.MethodType):
            waiting.append(part.__self__)
        elif isinstance(part, functools.partial):
            waiting += [part.func, part.args, part.keywords]
        elif not isinstance(part, np.ndarray | memoryview):
            waiting += list(getattr(part, "__dict__", {}).values())
            slots = (name for kind in type(part).__mro__ for name in getattr(kind, "__slots__", ()))
            waiting += [getattr(part, name) for name in slots if hasattr(part, name)]


_ATOMS = (type, types.ModuleType, types.FunctionType, str, bytes, int, float, type(None))


TeamAutopilots = Literal["px4", "ardupilot", "mixed"]
TEAM_AUTOPILOTS: tuple[TeamAutopilots, ...] = get_args(TeamAutopilots)
HOLD = 10.0
"""Hold timeout T of the failure tests, seconds; short, to save simulated time."""
_AUTOPILOTS: Mapping[TeamAutopilots, tuple[Literal["px4", "ardupilot"], ...]] = {
    "px4": ("px4",),
    "ardupilot": ("ardupilot",),
    "mixed": ("px4", "ardupilot"),
}
_ACK = bytes((77, 0, 0))
"""The message id of COMMAND_ACK in a MAVLink 2 header."""


def failure_test_fleet(vehicles: int, personality: TeamAutopilots, seed: int = 1) -> Fleet:
    """Return the emulated fleet of the failure tests: the default one with a short T."""
    fleet = emulated_fleet(vehicles, _AUTOPILOTS[personality], seed=seed)
    limits = fleet.limits.model_copy(update={"hold": HOLD})
    return fleet.model_copy(update={"limits": limits})


def set_audited_parameters(emulator: Emulator, flight_plan: CertifiedPlan, fleet: Fleet) -> None:
    """Set the parameters of emulated vehicles to the values that the audit requires."""
    demands = plan_requirements(flight_plan.plan, fleet)
    for vehicle in emulator.vehicles:
        values = vehicle.parameters.values
        for rule in rules(vehicle.spec.autopilot, demands):
            if rule.name in values and not rule.good(values[rule.name]):
                required = rule.should
                value = required(values[rule.name]) if callable(required) else required
                values[rule.name] = type(values[rule.name])(value)
                vehicle.autopilot.parameter_changed(rule.name)


def lasting(flight: Conductor) -> tuple[object, ...]:
    """Return the constants of a flight and what it has recorded, which its copies share."""
    setup = flight.state.setup
    return setup, setup.monitor, flight.state.stream_loss, *flight.state.recorder.samples


def nothing_pending(flight: Conductor, emulator: Emulator) -> bool:
    """Return whether no command and no delayed action is pending, which a copy would lose."""
    return all(vehicle.commands.idle for vehicle in flight.flyers) and not any(
        vehicle.timers for vehicle in emulator.vehicles
    )


@dataclass(eq=False)
class SteppedSimulation(Simulation):
    """A flight in equal steps of virtual time, which can be copied."""

    ticks: int = 0

    @classmethod
    def create(cls, flight_plan: CertifiedPlan, fleet: Fleet, seed: int) -> "SteppedSimulation":
        """Return a flight before its first tick; its vehicles' parameters pass the audit."""
        world = emulated_world(flight_plan.plan, fleet, with_cable=True, seed=seed)
        emulator = Emulator(parse_world(json.dumps(world)))
        set_audited_parameters(emulator, flight_plan, fleet)
        return cls(flight_plan, fleet, Conductor(flight_plan, fleet), emulator)

    @property
    def now(self) -> float:
        """Seconds since the record began."""
        return self.ticks / self.fleet.rates.setpoint

    def copy(self) -> "SteppedSimulation":
        """Return an independent copy of this flight."""
        return branch(self, lasting(self.conductor))

    def step(self, *, station: bool = True) -> None:
        """Advance by one step; without ``station`` the ground station is stopped."""
        self.ticks += 1
        self.advance(self.now, station=station)

    def land_by_pilot(self, system: int) -> None:
        """Switch a vehicle in manual mode to landing, as its pilot would."""
        vehicle = next(v for v in self.conductor.flyers if v.system == system)
        if vehicle.autopilot is not None and vehicle.in_manual_mode:
            main, sub = vehicle.autopilot.modes["land"]
            land = common.MAVLink_command_long_message(
                system, 1, common.MAV_CMD_DO_SET_MODE, 0, 1, main, sub, 0, 0, 0, 0
            )
            self.emulator.receive(system, land.pack(common.MAVLink(None, 254, 190)), self.now)

    @property
    def can_be_copied(self) -> bool:
        """Whether nothing is pending that a copy would lose."""
        return nothing_pending(self.conductor, self.emulator)


class FirstAckLoss:
    """Drops the first acknowledgement that a vehicle sends."""

    def __init__(self, system: int) -> None:
        self._system = system
        self.lost = 0

    def __call__(self, system: int, data: bytes) -> bool:
        """Return whether a packet is delivered."""
        if system == self._system and self.lost == 0 and _ACK in data:
            self.lost += 1
            return False
        return True
