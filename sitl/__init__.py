"""Emulated vehicles that any MAVLink client takes for real ones, tied to one cable.

    world = load_world("world.yaml")
    emulator = Emulator(world)
    emulator.receive(1, some_bytes, now=0.0)
    for vehicle, data in emulator.step(0.05):
        ...

Written from the autopilots' documented and measured behaviour; it shares no protocol code with the
ground station.
"""

from sitl.emulator import Emulator, Truth
from sitl.world import World, WorldError, default_world, load_world, parse_world

__all__ = [
    "Emulator",
    "Truth",
    "World",
    "WorldError",
    "default_world",
    "load_world",
    "parse_world",
]
