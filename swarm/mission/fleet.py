"""The fleet: which vehicles, on which links, in which frame.

Text in, a frozen :class:`Fleet` out; every error with its key path. The default is the built-in
emulator.
"""

import re
from collections import Counter
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StringConstraints, field_validator, model_validator

from swarm.mission.validation import Section, apply_overrides, number, parse_yaml, validate

Autopilot = Literal["px4", "ardupilot", "detect"]
SystemId = Annotated[int, Field(strict=True, ge=1, le=250)]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.-]{1,40}$")]

_URL = re.compile(
    r"(?:(?P<udp>udpin|udpout|tcp)://(?P<host>[^/:\s]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})"
    r"|serial://(?P<device>[^:\s]+):(?P<baud>\d{3,7}))"
)


class Vehicle(Section):
    """One vehicle of the fleet."""

    sysid: SystemId = Field(description="MAVLink system id, 1 to 250.")
    links: tuple[Name, ...] = Field(
        min_length=1, description="Names of the links on which it is heard; the first is preferred."
    )
    autopilot: Autopilot = Field("detect", description="Its autopilot; `detect` asks heartbeats.")
    pad: Annotated[int, Field(strict=True, ge=1)] | None = Field(
        None, description="Number of its pad (1 is the cable's first end); else the nearest one."
    )


class Place(Section):
    """Where the mission's (0, 0, 0) lies on the earth, and how its axes are turned."""

    latitude: float = number(..., "degrees", "Latitude.", least=-89.0, most=89.0)
    longitude: float = number(..., "degrees", "Longitude.", least=-180.0, most=180.0)
    altitude: float | None = number(
        None, "metres", "Height of the floor above mean sea level; else as the vehicles say.",
        least=-500.0, most=9000.0,
    )  # fmt: skip
    heading: float = number(
        0.0, "degrees", "Compass heading of the mission's y axis.", least=-360.0, most=360.0
    )


class Rates(Section):
    """How often what is sent and asked for."""

    setpoint: float = number(20.0, "Hz", "Setpoints to every vehicle.", least=4.0, most=100.0)
    position: float = number(10.0, "Hz", "Positions from every vehicle.", least=2.0, most=100.0)
    heartbeat: float = number(
        4.0, "Hz", "Heartbeats of every vehicle: modes and arming.", least=1.0, most=20.0
    )
    status: float = number(2.0, "Hz", "Attitude, landed state, battery.", least=0.5, most=20.0)


class Limits(Section):
    """When the flight stops waiting or stops going on."""

    silence: float = number(
        0.7,
        "s",
        "A vehicle that is not heard for so long holds the whole team; the longer, the "
        "slower the team flies where one that stops would be in the others' way.",
        above=0.1,
    )
    lost: float = number(
        5.0, "s", "A vehicle that is not heard for so long is lost: the others land.", above=0.2
    )
    hold: float = number(
        60.0, "s", "After so long on hold everybody lands together; autopilots that miss the "
        "ground station must be set to the same time.", least=5.0, most=120.0,
    )  # fmt: skip
    placement: float = number(
        0.5, "metres", "How far a vehicle may stand from its pad.", above=0.0, most=5.0
    )
    ready: float = number(
        90.0, "s", "How long to wait until all vehicles are ready to arm.", above=1.0
    )
    descent: float = number(
        0.6,
        "m/s",
        "Speed at which the team lands together; PX4 documents 0.6 as the least.",
        above=0.05,
        most=2.0,
    )


class Emulated(Section):
    """Vehicles that the built-in emulator flies."""

    biases: Literal["default", "none"] = Field(
        "default", description="Whether every vehicle has its own origin, clock and biases."
    )
    seed: Annotated[int, Field(strict=True, ge=0)] = Field(1, description="Seed of its chances.")


class Fleet(Section):
    """A fleet file, validated."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this format.")
    name: Name = Field(description="What the fleet is called.")
    links: dict[Name, str] = Field(
        min_length=1,
        description="Links by name: udpin://host:port, udpout://host:port, tcp://host:port or "
        "serial://device:baud.",
    )
    vehicles: tuple[Vehicle, ...] = Field(min_length=1, description="The vehicles.")
    capacity: dict[Name, Annotated[float, Field(gt=0.0)]] = Field(
        {},
        description="What a link carries in kbit/s, where a radio behind it is slower than the "
        "link itself (a serial port's is known).",
    )
    frame: Literal["gps", "shared", "pads"] = Field(
        "gps",
        description="gps: every vehicle has its own origin on the earth; shared: all have the "
        "mission's (motion capture); pads: each stands on its pad, wherever it thinks it is "
        "(simulators that put all vehicles in one place).",
    )
    origin: Place | None = Field(
        None, description="Where the mission lies (frame: gps); else fitted to the vehicles' pads."
    )
    gripper: Literal["mavlink", "attached", "none"] = Field(
        "mavlink", description="How the cable is held: by MAVLink grippers, tied on, or not at all."
    )
    signing_key: str | None = Field(
        None, description="File with the MAVLink 2 signing key, readable only by its owner."
    )
    rates: Rates = Field(Rates(), description="Rates.")
    limits: Limits = Field(Limits(), description="Limits.")
    emulated: Emulated | None = Field(
        None, description="Have the built-in emulator fly these vehicles."
    )

    @field_validator("links")
    @classmethod
    def _urls(cls, links: dict[str, str]) -> dict[str, str]:
        wrong = [
            f"{name} = {url!r}"
            for name, url in links.items()
            if not (found := _URL.fullmatch(url)) or int(found["port"] or 0) > 65535
        ]
        if wrong:
            raise ValueError(
                "expected udpin://host:port, udpout://host:port, tcp://host:port or "
                f"serial://device:baud, got {', '.join(wrong)}"
            )
        return links

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        problems = []
        twice = [k for k, count in Counter(v.sysid for v in self.vehicles).items() if count > 1]
        if twice:
            problems.append(f"sysid {_listed(twice)} given more than once")
        pads = Counter(v.pad for v in self.vehicles if v.pad is not None)
        shared = [k for k, count in pads.items() if count > 1]
        if shared:
            problems.append(f"pad {_listed(shared)} given more than once")
        named = {link for vehicle in self.vehicles for link in vehicle.links}
        if missing := sorted(named - self.links.keys()):
            problems.append(f"links {_listed(missing)} not among the links")
        if unknown := sorted(self.capacity.keys() - self.links.keys()):
            problems.append(f"capacity given for {_listed(unknown)}, not among the links")
        if self.emulated and any(v.autopilot == "detect" for v in self.vehicles):
            problems.append("emulated vehicles need an autopilot: px4 or ardupilot")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def capacities(self) -> dict[str, float]:
        """Bits per second of the links of which it is known; serial ports send ten per byte."""
        known = {name: 1000.0 * kilobits for name, kilobits in self.capacity.items()}
        for name, url in self.links.items():
            match = _URL.fullmatch(url)
            if match and match["baud"]:
                serial = 0.8 * float(match["baud"])
                known[name] = min(serial, known.get(name, serial))
        return known

    @property
    def systems(self) -> tuple[int, ...]:
        """System ids in the order of the file."""
        return tuple(vehicle.sysid for vehicle in self.vehicles)


def _listed(items: Iterable[Any]) -> str:
    return ", ".join(str(item) for item in items)


def parse_fleet(text: str, source: str, overrides: Iterable[str] = ()) -> Fleet:
    """Turn a fleet file's text into a :class:`Fleet`.

    ``source`` names the file in errors, ``overrides`` are ``key.path=value`` strings. Raises
    :class:`swarm.errors.InputError` with every problem at once.
    """
    return validate(Fleet, apply_overrides(parse_yaml(text, source), overrides), source)


def emulated_fleet(
    vehicles: int,
    autopilots: tuple[Literal["px4", "ardupilot"], ...] = ("px4",),
    *,
    seed: int = 1,
    biases: Literal["default", "none"] = "default",
) -> Fleet:
    """Return the built-in emulator's fleet; personalities are dealt out in turn."""
    document = {
        "schema": 1,
        "name": "emulator",
        "links": {"loopback": "udpin://127.0.0.1:0"},
        "vehicles": [
            {
                "sysid": number + 1,
                "links": ["loopback"],
                "autopilot": autopilots[number % len(autopilots)],
                "pad": number + 1,
            }
            for number in range(vehicles)
        ],
        "origin": {"latitude": 47.397742, "longitude": 8.545594, "altitude": 488.0},
        "emulated": {"seed": seed, "biases": biases},
    }
    return validate(Fleet, document, "emulator")


def fleet_schema() -> dict[str, Any]:
    """Return the JSON schema of fleet files, for editors."""
    return Fleet.model_json_schema(by_alias=True)
