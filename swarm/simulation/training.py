"""Scenario files for training flights: the emulator's faults, without what trials draw."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sitl.faults import KINDS
from swarm.errors import InputError, Problem
from swarm.files import read_text
from swarm.flight.training import InjectedFault, Training
from swarm.mission.validation import LARGEST_FILE
from swarm.simulation.loop import Fault
from swarm.simulation.spread import read_scenario

_COMMON = {"at", "kind", "vehicle", "duration"}
"""Keys of every fault."""


@dataclass(frozen=True)
class Scenario:
    """The faults of a scenario file; ``spreads``: whether it has distributions for trials, too."""

    name: str
    digest: str
    faults: tuple[Fault, ...]
    spreads: bool

    def training(self, systems: Sequence[int]) -> Training:
        """Return the training of vehicles with these system ids, in their order.

        Raises :class:`InputError` for faults of other vehicles.
        """
        named = {
            system
            for fault in self.faults
            if fault.vehicle != "all"
            for system in ([fault.vehicle] if isinstance(fault.vehicle, int) else fault.vehicle)
        }
        if unknown := sorted(named - {*systems}):
            words = ", ".join(map(str, systems))
            message = f"expected vehicles {words}, got {', '.join(map(str, unknown))}"
            raise InputError([Problem(f"{self.name}: faults", message)])
        faults = tuple(_injected(fault, systems) for fault in self.faults)
        dumped = [fault.model_dump(mode="json", exclude_unset=True) for fault in self.faults]
        return Training(self.name, self.digest, faults, {"schema": 1, "faults": dumped})


def read_training(path: Path) -> Scenario:
    """Read a scenario file; raises :class:`InputError` with every problem, and without faults."""
    text = read_text(path, LARGEST_FILE)
    spread, faults = read_scenario(text, str(path))
    if not faults:
        raise InputError([Problem(f"{path}: faults", "expected at least one fault to train with")])
    digest = hashlib.sha256(text.encode()).hexdigest()
    return Scenario(path.name, digest, faults, bool(spread.model_fields_set))


def _injected(fault: Fault, systems: Sequence[int]) -> InjectedFault:
    named = [fault.vehicle] if isinstance(fault.vehicle, int) else fault.vehicle
    world = KINDS[fault.kind].reach == "world"
    vehicles = () if world else systems if named == "all" else named
    values = fault.model_dump(mode="json", exclude_unset=True, exclude=_COMMON)
    details = ", ".join(f"{key} {_words(value)}" for key, value in values.items())
    numbers = tuple(sorted(systems.index(system) + 1 for system in vehicles))
    return InjectedFault(fault.at, fault.kind.replace("_", " "), details, numbers, fault.duration)


def _words(value: object) -> str:
    if isinstance(value, list):
        return f"({', '.join(f'{part:g}' for part in value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)
