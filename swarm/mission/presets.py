"""Vehicles to start from: values of mission files, each with its source."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Preset:
    """Values of mission files for a kind of vehicle.

    ``values`` are key path → (value, source); ``advice`` are lines for the head of the file.
    """

    name: str
    description: str
    values: Mapping[str, tuple[float, str]]
    advice: tuple[str, ...] = ()

    @property
    def overrides(self) -> tuple[str, ...]:
        """The values as ``key.path=value`` overrides."""
        return tuple(f"{path}={value:g}" for path, (value, _) in self.values.items())


_MEASURE = "assumed; measure yours: swarm check MISSION --fleet FLEET --hop"
_ROTOR = "0.25 m from centre to motor and half of a 10-inch rotor (0.13 m)"
_FULL_SIZE = {
    "vehicles.radius": (0.38, _ROTOR),
    "vehicles.grip_offset": (0.6, "a dropper that keeps the cable below the rotors; make it so"),
    "vehicles.max_speed": (2.0, "a fraction of what it can fly; tracking errors grow with it"),
    "vehicles.max_acceleration": (2.0, "leans by 12 degrees"),
    "vehicles.tracking": (0.1, _MEASURE),
    "clearance.vehicle": (1.2, "0.4 m between the rotors of two vehicles"),
    "clearance.vehicle_cable": (0.45, "0.07 m more than the rotors reach"),
}

PRESETS: Mapping[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset(
            "px4-500mm",
            "a quadrotor of 500 mm with 10-inch rotors, as PX4 simulates (gz_x500)",
            {
                **_FULL_SIZE,
                "vehicles.mass": (2.0, "PX4's simulation model x500: 2.0 kg without its rotors"),
                "vehicles.payload": (0.4, "assumed: a fifth of its mass"),
                "vehicles.endurance": (600.0, "assumed; time a hover with the payload"),
            },
        ),
        Preset(
            "holybro-x500",
            "the Holybro X500 V2 kit: 500 mm, 10x4.5-inch rotors, 4S battery of 5 Ah",
            {
                **_FULL_SIZE,
                "vehicles.mass": (2.3, "simulation models of it have 2.0 to 2.3 kg; weigh yours"),
                "vehicles.payload": (0.5, "assumed: a fifth of its mass; hover it with the load"),
                "vehicles.endurance": (720.0, "assumed; time a hover with the payload"),
            },
        ),
        Preset(
            "crazyflie-like",
            "a quadrotor of 27 g and 92 mm, such as the Crazyflie 2.1, indoors",
            {
                "vehicles.radius": (0.07, "0.046 m to the motor and half of a rotor of 46 mm"),
                "vehicles.grip_offset": (0.15, "a thread that keeps the cable below the rotors"),
                "vehicles.mass": (0.027, "take-off weight of the Crazyflie 2.1"),
                "vehicles.payload": (0.015, "recommended limit of the Crazyflie 2.1"),
                "vehicles.max_speed": (0.5, "slow, for small tracking errors"),
                "vehicles.max_acceleration": (0.5, "slow, for small tracking errors"),
                "vehicles.braking_acceleration": (0.2, "below max_acceleration"),
                "vehicles.tracking": (0.03, _MEASURE),
                "vehicles.endurance": (420.0, "seven minutes without payload"),
                "cable.mass_per_length": (0.0003, "a thread: 15 g carry at most a few grams"),
                "cable.diameter": (0.001, "a thread"),
                "cable.breaking_load": (20.0, "a thread"),
                "cable.length_tolerance": (0.003, "mark the thread to 3 mm"),
                "clearance.cable": (0.05, "for a team whose errors are centimetres"),
                "clearance.vehicle": (0.3, "0.16 m between the rotors of two vehicles"),
                "clearance.downwash": (0.6, "about eight rotor radii below"),
                "clearance.vehicle_cable": (0.1, "0.03 m more than the rotors reach"),
                "clearance.floor": (0.2, "a team this small flies low"),
                "workspace.ceiling": (6.0, "the height of your hall"),
            },
            (
                "A Crazyflie does not speak MAVLink by itself: it needs a firmware or a bridge",
                "that does, as PX4 or ArduPilot would, and motion capture for its position.",
            ),
        ),
    )
}
"""Name → preset, in the order in which they are listed."""
