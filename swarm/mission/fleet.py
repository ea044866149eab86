"""The fleet: vehicles, links, frame, rates and limits.

Parses text to a frozen :class:`Fleet`. Errors name the key path. The default fleet is the built-in
emulator.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StringConstraints, field_validator, model_validator

from swarm.mission.mission import LARGEST_TRACKING, Mission
from swarm.mission.validation import (
    Section,
    number,
    read_model,
    validate,
    with_values,
)

Autopilot = Literal["px4", "ardupilot", "detect"]
SystemId = Annotated[int, Field(strict=True, ge=1, le=250)]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.-]{1,40}$")]

_URL = re.compile(
    r"(?:(?P<udp>udpin|udpout|tcp)://(?P<host>[^/:\s]+|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})"
    r"|serial://(?P<device>[^:\s]+):(?P<baud>\d{3,7}))"
)


class FleetVehicle(Section, title="Vehicle"):
    """One vehicle of the fleet."""

    sysid: SystemId = Field(description="MAVLink system id, 1 to 250.")
    links: tuple[Name, ...] = Field(
        min_length=1, description="Names of the links to the vehicle; the first is preferred."
    )
    autopilot: Autopilot = Field(
        "detect", description="Autopilot of the vehicle; `detect`: read from its heartbeats."
    )
    pad: Annotated[int, Field(strict=True, ge=1)] | None = Field(
        None,
        description="Number of the pad, from 1 at the first end of the cable; default: nearest.",
    )
    drag: float | None = number(
        None, "1/s",
        "Horizontal drag per mass and speed, fed forward where the autopilot adds accelerations "
        "(PX4): 9.81 tan(lean) / speed in steady flight. 0: none; default: fitted in flight, by "
        "three vehicles or more with the cable aloft.",
        least=0.0, most=2.0,
    )  # fmt: skip


class Place(Section):
    """Position of the mission's origin (0, 0, 0) on the earth, and heading of its axes."""

    latitude: float = number(..., "degrees", "Latitude of the origin.", least=-89.0, most=89.0)
    longitude: float = number(..., "degrees", "Longitude of the origin.", least=-180.0, most=180.0)
    altitude: float | None = number(
        None, "metres", "Height of the floor above mean sea level; default: from the vehicles.",
        least=-500.0, most=9000.0,
    )  # fmt: skip
    heading: float = number(
        0.0, "degrees", "Compass heading of the mission's y axis.", least=-360.0, most=360.0
    )


class Rates(Section):
    """Rates of messages to and from every vehicle."""

    setpoint: float = number(
        20.0, "Hz", "Rate of setpoints to every vehicle.", least=4.0, most=100.0
    )
    position: float = number(
        10.0, "Hz", "Rate of position messages from every vehicle.", least=2.0, most=100.0
    )
    heartbeat: float = number(
        4.0,
        "Hz",
        "Rate of heartbeats from every vehicle, with mode and arming state.",
        least=1.0,
        most=20.0,
    )
    status: float = number(
        2.0,
        "Hz",
        "Rate of attitude, landed state and battery messages from every vehicle.",
        least=0.5,
        most=20.0,
    )


class Limits(Section):
    """Time limits, and limits of placement and descent."""

    silence: float = number(
        0.7,
        "s",
        "Time without messages from a vehicle, or without its answers, after which the team holds; "
        "with a longer time the team flies slower where a stopped vehicle would obstruct others.",
        above=0.1,
        most=10.0,
    )
    lost: float = number(
        5.0,
        "s",
        "Time without messages from a vehicle after which it is lost and the others land.",
        above=0.2,
        most=60.0,
    )
    hold: float = number(
        60.0, "s", "Hold timeout T, after which the team lands together; autopilots must use the "
        "same time after the loss of the ground station.",
        # an ArduCopter descends 4 s after its failsafe, and misses heartbeats for 4 s before it
        least=8.0, most=120.0,
    )  # fmt: skip
    placement: float = number(
        0.5,
        "metres",
        "Largest distance of a vehicle from its pad before take-off.",
        above=0.0,
        most=5.0,
    )
    ready: float = number(
        90.0,
        "s",
        "Largest time to wait until all vehicles are ready to arm.",
        above=1.0,
        most=3600.0,
    )
    descent: float = number(
        0.6,
        "m/s",
        "Speed of a common landing; the documented minimum of PX4 is 0.6.",
        above=0.05,
        most=2.0,
    )


CableModel = Literal["swinging", "static"]


class Capture(Section):
    """The motion capture system of emulated vehicles that know their positions by one."""

    delay: float = number(
        0.02, "s", "Time from the capture of a pose until it is sent.", least=0.0, most=0.25
    )
    noise: float = number(
        0.0005, "metres", "Standard deviation of captured positions.", least=0.0, most=0.1
    )


class Emulated(Section):
    """Settings of the built-in emulator."""

    biases: Literal["default", "none"] = Field(
        "default",
        description="default: every vehicle has its own origin, clock offset and biases; "
        "none: it has none.",
    )
    seed: Annotated[int, Field(strict=True, ge=0)] = Field(
        1, description="Seed of the random numbers."
    )
    cable: CableModel = Field(
        "swinging",
        description="Model of the cable: swinging: a chain of masses with drag; static: catenaries "
        "without inertia.",
    )
    capture: Capture = Field(
        Capture(), description="The motion capture system (`--positioning mocap`)."
    )


class Fleet(Section):
    """A fleet: the validated content of a fleet file."""

    schema_version: Literal[1] = Field(
        alias="schema", description="Version of this format.", examples=[1]
    )
    name: Name = Field(description="Name of the fleet.", examples=["my-fleet"])
    links: dict[Name, str] = Field(
        min_length=1,
        examples=["{radio: udpin://0.0.0.0:14550}"],
        description="Links by name: udpin://host:port, udpout://host:port, tcp://host:port or "
        "serial://device:baud.",
    )
    vehicles: tuple[FleetVehicle, ...] = Field(
        min_length=1, description="The vehicles.", examples=["[{sysid: 1, links: [radio]}]"]
    )
    capacity: dict[Name, Annotated[float, Field(gt=0.0)]] = Field(
        {},
        description="Capacity of links in kbit/s, for links with a slower radio behind them (the "
        "capacity of a serial port follows from its baud rate).",
    )
    frame: Literal["gps", "shared", "pads"] = Field(
        "gps",
        description="Frame of the vehicles' positions. gps: every vehicle has its own origin on "
        "the earth; shared: all use the mission's origin (motion capture); pads: every vehicle "
        "starts on its pad, whatever position it reports (simulators that start all vehicles in "
        "one place).",
    )
    origin: Place | None = Field(
        None,
        description="Origin of the mission on the earth (frame: gps); default: fitted to the "
        "positions of the vehicles.",
    )
    gripper: Literal["mavlink", "attached", "none"] = Field(
        "mavlink",
        description="mavlink: MAVLink grippers hold the cable; attached: it is tied on; none: "
        "there is no cable.",
    )
    signing_key: str | None = Field(
        None,
        description="Path of the file with the MAVLink 2 signing key; only its owner may read it.",
    )
    tracking: float | None = number(
        None, "metres",
        "Tracking error of these vehicles, as `swarm check --hop` measured it: plans for the fleet "
        "are certified for it, where the mission's own `vehicles.tracking` is smaller.",
        above=0.0, most=LARGEST_TRACKING,
    )  # fmt: skip
    rates: Rates = Field(Rates(), description="Rates of messages.")
    limits: Limits = Field(Limits(), description="Limits of the flight.")
    emulated: Emulated | None = Field(
        None, description="Settings of the built-in emulator, where it emulates these vehicles."
    )

    @field_validator("links")
    @classmethod
    def _urls(cls, links: dict[str, str]) -> dict[str, str]:
        wrong = [
            f"{name} = {url!r}"
            for name, url in links.items()
            if not (match := _URL.fullmatch(url)) or int(match["port"] or 0) > 65535
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
        """Known capacities of links, bits per second; a serial port sends ten bits per byte."""
        known = {name: 1000.0 * kilobits for name, kilobits in self.capacity.items()}
        for name, url in self.links.items():
            match = _URL.fullmatch(url)
            if match and match["baud"]:
                serial = 0.8 * float(match["baud"])
                known[name] = min(serial, known.get(name, serial))
        return known

    @property
    def identity(self) -> str:
        """What identifies these vehicles: a digest of the name, system ids and autopilots.

        Links, limits and measurements may change.
        """
        vehicles = sorted((vehicle.sysid, vehicle.autopilot) for vehicle in self.vehicles)
        return hashlib.sha256(repr((self.name, vehicles)).encode()).hexdigest()

    @property
    def systems(self) -> tuple[int, ...]:
        """System ids in the order of the file."""
        return tuple(vehicle.sysid for vehicle in self.vehicles)


def _listed(items: Iterable[Any]) -> str:
    return ", ".join(str(item) for item in items)


def parse_fleet(text: str, source: str, overrides: Iterable[str] = ()) -> Fleet:
    """Return the fleet of a fleet file's text.

    ``source`` names the file in errors, ``overrides`` are ``key.path=value`` strings. Raises
    :class:`swarm.errors.InputError` with every problem at once.
    """
    return read_model(Fleet, text, source, overrides)


def with_tracking(text: str, tracking: float, signing_key: str | None = None) -> str:
    """Return the text of a valid fleet file with its measured tracking error, metres.

    ``signing_key`` replaces a given path, which starts at the folder of the file.
    """
    values: dict[str, Any] = {"tracking": tracking}
    return with_values(text, values | ({"signing_key": signing_key} if signing_key else {}))


def mission_for(mission: Mission, fleet: Fleet) -> Mission:
    """Return the mission to plan for a fleet: with its measured tracking error, if that is larger.

    Otherwise the mission itself is returned: a mission may ask for more than was measured.
    """
    measured = fleet.tracking
    if measured is None or measured <= mission.vehicles.tracking:
        return mission
    vehicles = mission.vehicles.model_copy(update={"tracking": measured})
    return mission.model_copy(update={"vehicles": vehicles})


def emulated_fleet(
    vehicles: int,
    autopilots: tuple[Literal["px4", "ardupilot"], ...] = ("px4",),
    *,
    seed: int = 1,
    biases: Literal["default", "none"] = "default",
    cable: CableModel = "swinging",
) -> Fleet:
    """Return a fleet for the built-in emulator; the autopilots are assigned in turn."""
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
        "emulated": {"seed": seed, "biases": biases, "cable": cable},
    }
    return validate(Fleet, document, "emulator")


def fleet_schema() -> dict[str, Any]:
    """Return the JSON schema of fleet files, for editors."""
    return Fleet.model_json_schema(by_alias=True)
