"""The world file: vehicles and their pads, the cable and how it lies, floor, wind, seed.

It knows nothing of knots or plans. A file is checked once, here: unknown keys are errors, and every
error is reported at once as ``file: key.path: expected …, got …``.
"""

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

_KEY_LENGTH = 32
_LARGEST_FILE = 4_000_000
ALONE = 200.0
"""Metres between vehicles that shall never meet."""
_DEEPEST = 50

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = tuple[Number, Number, Number]


class WorldError(Exception):
    """A world or scenario file that cannot be used; the text lists every error, one a line."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Origin(_Strict):
    """Where the world's ENU origin lies on the Earth (degrees, metres above mean sea level)."""

    latitude: Annotated[float, Field(ge=-89, le=89)] = Field(
        default=47.397742, description="degrees north"
    )
    longitude: Annotated[float, Field(ge=-180, le=180)] = Field(
        default=8.545594, description="degrees east"
    )
    altitude: Number = Field(default=488.0, description="metres above mean sea level")


class Wind(_Strict):
    """Wind: a steady part (m/s, ENU, where it blows to) and a Dryden gust intensity (m/s)."""

    steady: Point = Field(default=(0.0, 0.0, 0.0), description="m/s, ENU, where it blows to")
    gust: NotNegative = Field(default=0.0, description="Dryden intensity of gusts, m/s")


class VehicleSpec(_Strict):
    """One vehicle: its system id, where it stands and what it can do (SI units, ENU)."""

    id: Annotated[int, Field(ge=1, le=250)] = Field(description="MAVLink system id")
    autopilot: Literal["px4", "ardupilot"] = Field(
        default="px4", description="the autopilot that it behaves like"
    )
    pad: Point = Field(description="where it stands, metres ENU")
    heading: Number = Field(
        default=0.0, description="radians, compass: 0 north, clockwise seen from above"
    )
    mass: Positive = Field(default=1.5, description="kg")
    payload: NotNegative = Field(
        default=0.4, description="kg it can lift beside itself with half its thrust in reserve"
    )
    radius: Positive = Field(default=0.25, description="rotor disc and collision radius, m")
    grip_offset: NotNegative = Field(
        default=0.6, description="height of the centre over the grip point, m; also its legs"
    )
    max_speed: Positive = Field(default=5.0, description="largest speed, m/s")
    max_acceleration: Positive = Field(default=4.0, description="largest acceleration, m/s²")
    gripper: Literal["mavlink", "attached", "none"] = Field(
        default="mavlink",
        description="how it holds cable: by a gripper that obeys MAVLink, tied on, or not at all",
    )
    radio: bool = Field(default=False, description="a pilot's transmitter is switched on")
    gps_noise: NotNegative = Field(
        default=0.0,
        description="metres by which its receiver's altitude jumps about (standard deviation; the "
        "place by 0.4 of it), but not its estimate; 0.5 is PX4's simulated receiver",
    )
    disturbance: NotNegative = Field(
        default=0.0,
        description="m/s² on each axis, standard deviation of a random acceleration that its "
        "controller must reject (first-order Gauss-Markov over 2 s), as errors of an attitude "
        "estimate cause; with 0.6 it hovers as PX4 does in its own simulator (SIH): 0.35 m RMS",
    )
    endurance: Positive = Field(default=900.0, description="hovering time of a full battery, s")


class CableSpec(_Strict):
    """The cable: kg/m, m, the polyline as which it lies, N at which it snaps, N per unit strain."""

    mass_per_length: Positive = Field(default=0.012, description="kg/m")
    diameter: Positive = Field(default=0.006, description="metres")
    points: Annotated[list[Point], Field(min_length=2)] = Field(
        description="the polyline as which it lies at the start, metres ENU"
    )
    breaking_load: Positive = Field(default=200.0, description="newtons at which it snaps")
    stiffness: Positive = Field(default=1500.0, description="axial stiffness EA, N")
    model: Literal["static", "swinging"] = Field(
        default="static",
        description="static: catenaries without inertia; swinging: a chain of masses with drag",
    )
    attached: list[NotNegative] | None = Field(
        default=None,
        description="arc lengths tied to the vehicles whose gripper is `attached`, in file order",
    )


class World(_Strict):
    """Everything that the emulator is told before it starts."""

    schema_: Literal[1] = Field(default=1, alias="schema", description="version of this format")
    seed: Annotated[int, Field(ge=0)] = Field(
        default=1, description="seed of everything that is random"
    )
    origin: Origin = Field(default=Origin(), description="where on the Earth")
    floor: Number = Field(default=0.0, description="height of the floor, metres")
    wind: Wind = Field(default=Wind(), description="the wind")
    indoor: bool = Field(
        default=False, description="no GPS: position comes from VISION_POSITION_ESTIMATE/ODOMETRY"
    )
    vehicles: Annotated[list[VehicleSpec], Field(min_length=1, max_length=250)] = Field(
        description="the vehicles"
    )
    cable: CableSpec | None = Field(default=None, description="the cable; none: there is none")
    biases: Literal["default", "none"] = Field(
        default="default",
        description="whether every vehicle has errors of its own: origin, clock, position",
    )
    local_origin: Literal["anywhere", "pad"] = Field(
        default="anywhere",
        description="where estimators began, from which local positions count: each anywhere "
        "within 30 m of its vehicle's pad, 3 m up or down (with `biases: default`), or on the pad",
    )
    projection: Literal["exact", "autopilot"] = Field(
        default="autopilot",
        description="how estimators turn degrees into local metres: as each autopilot does (PX4 on "
        "a sphere, ArduPilot with the equator's scale: up to 0.3 % off), or exactly (WGS-84)",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "World":
        ids = [vehicle.id for vehicle in self.vehicles]
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            raise ValueError(f"vehicles: expected every id once, got {twice} more than once")
        tied = [vehicle.id for vehicle in self.vehicles if vehicle.gripper == "attached"]
        given = self.cable.attached if self.cable else None
        if tied and (given is None or len(given) != len(tied)):
            raise ValueError(
                f"cable.attached: expected one arc length for each of {len(tied)} vehicles whose "
                f"gripper is 'attached', got {0 if given is None else len(given)}"
            )
        if given is not None and not tied:
            raise ValueError("cable.attached: expected vehicles with gripper 'attached', got none")
        return self


def parse_world(text: str, name: str = "world") -> World:
    """Turn the text of a world file (YAML or JSON) into a `World`.

    Raises `WorldError` with every error found, one a line, each ``name: key.path: …``.
    """
    data = parse_yaml(text, name)
    try:
        return World.model_validate(data, by_alias=True, by_name=False)
    except ValidationError as error:
        raise WorldError(explain(error, name)) from None


def parse_yaml(text: str, name: str) -> Any:
    """Parse YAML or JSON safely (no tags, bounded size); `WorldError` with line and column."""
    if len(text) > _LARGEST_FILE:
        raise WorldError(f"{name}: expected at most {_LARGEST_FILE} characters, got {len(text)}")
    if _depth(text) > _DEEPEST:
        raise WorldError(f"{name}: expected at most {_DEEPEST} nested brackets, got more")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    try:
        return YAML(typ="safe", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        place = f"{mark.line + 1}:{mark.column + 1}: " if mark else ""
        raise WorldError(f"{name}:{place}expected YAML, got {error.problem}") from None
    except (YAMLError, RecursionError, ValueError) as error:
        raise WorldError(f"{name}: expected YAML, got {type(error).__name__}") from None


def _depth(text: str) -> int:
    """How deep brackets nest (those in text too): what keeps a parser from running wild."""
    depth = deepest = 0
    for mark in re.findall(r"[\[\]{}]", text):
        depth += 1 if mark in "[{" else -1
        deepest = max(deepest, depth)
    return deepest


def explain(error: ValidationError, name: str) -> str:
    """Return every validation error as a line ``name: key.path: expected …, got …``."""
    lines = []
    for one in error.errors():
        place = ".".join(str(part) for part in one["loc"])
        if one["type"] == "value_error":
            where = f"{place}: " if place else ""
            lines.append(f"{name}: {where}{one['msg'].removeprefix('Value error, ')}")
        elif one["type"] == "extra_forbidden":
            lines.append(f"{name}: {place}: expected a known key, got this one")
        elif one["type"] == "missing":
            lines.append(f"{name}: {place}: expected a value, got nothing")
        else:
            message = one["msg"].removeprefix("Input should be ").strip()
            lines.append(f"{name}: {place or 'file'}: expected {message}, got {_short(one)}")
    return "\n".join(lines)


def _short(one: Any) -> str:
    text = repr(one["input"])
    return text if len(text) <= 60 else text[:57] + "…"


def load_world(path: str | Path) -> World:
    """Read and check a world file; `WorldError` if it cannot be read or used."""
    path = Path(path)
    return parse_world(read_text(path), str(path))


def _said(error: OSError) -> str:
    return error.strerror or repr(error)


def load_key(path: Path) -> bytes:
    """Read a signing key, 64 hexadecimal digits or 32 bytes; `WorldError` if it is none."""
    try:
        data = path.read_bytes()[:1024]
        key = data if len(data) == _KEY_LENGTH else bytes.fromhex(data.decode("ascii"))
    except OSError as error:
        raise WorldError(f"{path}: expected a readable file, got {_said(error)}") from None
    except ValueError:
        key = b""
    if len(key) != _KEY_LENGTH:
        raise WorldError(f"{path}: expected a key of {_KEY_LENGTH} bytes")
    return key


def read_text(path: Path) -> str:
    """Read a small text file; `WorldError` instead of an operating system's or codec's error."""
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
        return data.decode("utf-8")
    except OSError as error:
        raise WorldError(f"{path}: expected a readable file, got {_said(error)}") from None
    except UnicodeDecodeError as error:
        raise WorldError(f"{path}: expected UTF-8 text, got byte {error.start} otherwise") from None


def default_world(
    count: int, autopilots: Sequence[Literal["px4", "ardupilot"]] = ("px4",), seed: int = 1
) -> World:
    """Return ``count`` vehicles on a square grid of pads ALONE apart, without a cable.

    As in the autopilots' own simulators none ever meets another: ground stations that take each
    vehicle's place for where it should stand may fly them through each other there. Local positions
    count from the pads, as they do there.
    """
    side = math.ceil(math.sqrt(count))
    vehicles = [
        VehicleSpec(
            id=i + 1,
            autopilot=autopilots[i % len(autopilots)],
            pad=(ALONE * (i % side), ALONE * (i // side), 0.0),
        )
        for i in range(count)
    ]
    return World(schema=1, seed=seed, vehicles=vehicles, local_origin="pad")


def schema() -> dict[str, Any]:
    """Return the JSON schema of world files, for editors."""
    return World.model_json_schema(by_alias=True)
