"""The world file: vehicles and their pads, the cable and its initial shape, floor, wind, seed.

World files do not contain knots or plans. Files are validated here: unknown keys are errors, and
all errors are reported together, as ``file: key.path: expected …, got …``.
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
SEPARATE = 200.0
"""Metres between the pads of vehicles that never meet."""
_MOST_VALUES = 50_000
_MOST_NESTED = 50

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = tuple[Number, Number, Number]
Kind = Literal["px4", "ardupilot"]


class WorldError(Exception):
    """An invalid world or scenario file; the text lists every error, one per line."""


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
    """Wind: a steady part (m/s, ENU, to where it blows) and a Dryden gust intensity (m/s)."""

    steady: Point = Field(default=(0.0, 0.0, 0.0), description="m/s, ENU, to where it blows")
    gust: NotNegative = Field(default=0.0, description="Dryden intensity of gusts, m/s")


class Capture(_Strict):
    """The motion capture system of an emulated laboratory."""

    # 0.25 s: the largest that ArduPilot's estimator can take into account
    delay: Annotated[float, Field(ge=0, le=0.25)] = Field(
        default=0.02, description="from capture to sending, s; laboratories have 0.005 to 0.02"
    )
    noise: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.0005,
        description="standard deviation of positions, metres; calibrated systems have 0.0002 to "
        "0.001",
    )


class VehicleSpec(_Strict):
    """One vehicle: system id, pad, capabilities (SI units, ENU)."""

    id: Annotated[int, Field(ge=1, le=250)] = Field(description="MAVLink system id")
    autopilot: Kind = Field(default="px4", description="the autopilot that it emulates")
    pad: Point = Field(description="position of the pad, metres ENU")
    heading: Number = Field(
        default=0.0, description="radians, compass: 0 north, clockwise seen from above"
    )
    mass: Positive = Field(default=1.5, description="kg")
    payload: NotNegative = Field(
        default=0.4,
        description="kg beside its own mass that it lifts with half of its thrust",
    )
    radius: Positive = Field(default=0.25, description="rotor disc and collision radius, m")
    grip_offset: NotNegative = Field(
        default=0.6,
        description="height of the centre above the grip point, m; also its legs",
    )
    max_speed: Positive = Field(default=5.0, description="largest speed, m/s")
    max_acceleration: Positive = Field(default=4.0, description="largest acceleration, m/s²")
    gripper: Literal["mavlink", "attached", "none"] = Field(
        default="mavlink",
        description="grip: a gripper that obeys MAVLink, cable that is tied on, or none",
    )
    parameters: dict[str, Number] = Field(
        default={}, description="values that the autopilot starts with, beside its defaults"
    )
    radio: bool = Field(default=False, description="a pilot's transmitter is switched on")
    gps_noise: NotNegative = Field(
        default=0.0,
        description="standard deviation of the GPS receiver's altitude, metres (0.4 of that "
        "for east and north), without effect on the estimate; 0.5 is PX4's simulated receiver",
    )
    disturbance: NotNegative = Field(
        default=0.0,
        description="standard deviation of a random acceleration on each axis, m/s² (first-order "
        "Gauss-Markov over 2 s), as errors of an attitude estimate cause; with 0.6 it hovers as "
        "PX4 does in its own simulator (SIH): 0.35 m RMS",
    )
    endurance: Positive = Field(default=900.0, description="hovering time of a full battery, s")


class CableSpec(_Strict):
    """The cable: mass, diameter, initial shape, breaking load, stiffness, attached vehicles."""

    mass_per_length: Positive = Field(default=0.012, description="kg/m")
    diameter: Positive = Field(default=0.006, description="metres")
    points: Annotated[list[Point], Field(min_length=2)] = Field(
        description="polyline of its initial shape, metres ENU"
    )
    breaking_load: Positive = Field(default=200.0, description="tension at which it breaks, N")
    stiffness: Positive = Field(default=1500.0, description="axial stiffness EA, N")
    model: Literal["swinging", "static"] = Field(
        default="swinging",
        description="swinging: a chain of masses with drag; static: catenaries without inertia",
    )
    attached: list[NotNegative] | None = Field(
        default=None,
        description="arc lengths of the vehicles whose gripper is `attached`, in file order",
    )


class World(_Strict):
    """The initial state and settings of the emulator."""

    schema_: Literal[1] = Field(default=1, alias="schema", description="version of this format")
    seed: Annotated[int, Field(ge=0)] = Field(default=1, description="seed of all random numbers")
    origin: Origin = Field(default=Origin(), description="position on the Earth")
    floor: Number = Field(default=0.0, description="height of the floor, metres")
    wind: Wind = Field(default=Wind(), description="the wind")
    indoor: bool = Field(
        default=False,
        description="no GPS: position from VISION_POSITION_ESTIMATE or ODOMETRY",
    )
    capture: Capture = Field(
        default=Capture(), description="the motion capture system, where one sends the poses"
    )
    vehicles: Annotated[list[VehicleSpec], Field(min_length=1, max_length=250)] = Field(
        description="the vehicles"
    )
    cable: CableSpec | None = Field(default=None, description="the cable; none: no cable")
    biases: Literal["default", "none"] = Field(
        default="default",
        description="errors of each vehicle: origin, clock, position",
    )
    local_origin: Literal["anywhere", "pad"] = Field(
        default="anywhere",
        description="origin of local positions: anywhere within 30 m of the vehicle's pad and "
        "3 m above or below it (with `biases: default`), or on the pad",
    )
    projection: Literal["exact", "autopilot"] = Field(
        default="autopilot",
        description="conversion of degrees into local metres: as each autopilot does (PX4 on a "
        "sphere, ArduPilot with the equator's scale: errors up to 0.3 %), or exactly (WGS-84)",
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
    """Return the world in the text of a world file (YAML or JSON).

    Raises `WorldError` with all errors, one per line, each ``name: key.path: …``.
    """
    data = parse_yaml(text, name)
    try:
        return World.model_validate(data, by_alias=True, by_name=False)
    except ValidationError as error:
        raise WorldError(explain(error, name)) from None


def parse_yaml(text: str, name: str) -> Any:
    """Return parsed YAML or JSON (no tags, limited size); raise `WorldError` with the place."""
    if len(text) > _LARGEST_FILE:
        raise WorldError(f"{name}: expected at most {_LARGEST_FILE} characters, got {len(text)}")
    if _depth(text) > _MOST_NESTED:
        raise WorldError(f"{name}: expected at most {_MOST_NESTED} nested brackets, got more")
    try:
        return json.loads(text, object_pairs_hook=_each_key_once)
    except KeyError as error:
        raise WorldError(f"{name}: expected each key once, got {error} again") from None
    except (ValueError, RecursionError):
        pass
    loader = YAML(typ="safe", pure=True)
    try:
        _refuse_hostile(loader, text, name)
        return loader.load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        place = f"{mark.line + 1}:{mark.column + 1}: " if mark else ""
        raise WorldError(f"{name}:{place}expected YAML, got {error.problem}") from None
    except (YAMLError, RecursionError, ValueError) as error:
        raise WorldError(f"{name}: expected YAML, got {type(error).__name__}") from None


def _each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    for key, value in pairs:
        if key in mapping:
            raise KeyError(key)
        mapping[key] = value
    return mapping


def _refuse_hostile(loader: YAML, text: str, name: str) -> None:
    """Refuse aliases, which can stand for any amount of values, and what nests without brackets."""
    depth = 0
    for count, event in enumerate(loader.parse(text)):
        kind = type(event).__name__
        if kind == "AliasEvent":
            raise WorldError(f"{name}: expected YAML without aliases, got one")
        depth += kind.endswith("StartEvent") - kind.endswith("EndEvent")
        if depth > _MOST_NESTED:
            raise WorldError(f"{name}: expected at most {_MOST_NESTED} nested values, got more")
        if count > _MOST_VALUES:
            raise WorldError(f"{name}: expected at most {_MOST_VALUES} values, got more")


def _depth(text: str) -> int:
    """Return the depth of nested brackets, also in strings: a limit for the parser."""
    depth = deepest = 0
    for mark in re.findall(r"[\[\]{}]", text):
        depth += 1 if mark in "[{" else -1
        deepest = max(deepest, depth)
    return deepest


def explain(error: ValidationError, name: str) -> str:
    """Return every validation error as a line ``name: key.path: expected …, got …``."""
    lines = []
    for problem in error.errors():
        place = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "value_error":
            where = f"{place}: " if place else ""
            lines.append(f"{name}: {where}{problem['msg'].removeprefix('Value error, ')}")
        elif problem["type"] == "extra_forbidden":
            lines.append(f"{name}: {place}: expected a known key, got an unknown one")
        elif problem["type"] == "missing":
            lines.append(f"{name}: {place}: expected a value, got none")
        else:
            message = problem["msg"].removeprefix("Input should be ").strip()
            message = "a mapping of keys" if problem["type"] == "model_type" else message
            lines.append(f"{name}: {place or 'file'}: expected {message}, got {_short(problem)}")
    return "\n".join(lines)


def _short(problem: Any) -> str:
    try:
        text = repr(problem["input"])
    except ValueError:  # Python writes no integer of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "…"


def load_world(path: str | Path) -> World:
    """Return the world of a file; raise `WorldError` if it is unreadable or invalid."""
    path = Path(path)
    return parse_world(read_text(path), str(path))


def _reason(error: OSError) -> str:
    return error.strerror or repr(error)


def load_key(path: Path) -> bytes:
    """Return the signing key in a file: 64 hexadecimal digits or 32 bytes; raise `WorldError`."""
    try:
        data = path.read_bytes()[:1024]
        key = data if len(data) == _KEY_LENGTH else bytes.fromhex(data.decode("ascii"))
    except OSError as error:
        raise WorldError(f"{path}: expected a readable file, got {_reason(error)}") from None
    except ValueError:
        key = b""
    if len(key) != _KEY_LENGTH:
        raise WorldError(f"{path}: expected a key of {_KEY_LENGTH} bytes")
    return key


def read_text(path: Path) -> str:
    """Return the text of a small file; raise `WorldError` for errors of reading or decoding."""
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
        return data.decode("utf-8")
    except OSError as error:
        raise WorldError(f"{path}: expected a readable file, got {_reason(error)}") from None
    except UnicodeDecodeError as error:
        raise WorldError(
            f"{path}: expected UTF-8 text, got an invalid byte {error.start}"
        ) from None


def default_world(count: int, autopilots: Sequence[Kind] = ("px4",), seed: int = 1) -> World:
    """Return ``count`` vehicles on a square grid of pads SEPARATE apart, without a cable.

    As in the autopilots' own simulators, vehicles never meet: a ground station may place them
    anywhere relative to each other. Local positions start at the pads, as in those simulators.
    """
    side = math.ceil(math.sqrt(count))
    vehicles = [
        VehicleSpec(
            id=i + 1,
            autopilot=autopilots[i % len(autopilots)],
            pad=(SEPARATE * (i % side), SEPARATE * (i // side), 0.0),
        )
        for i in range(count)
    ]
    return World(schema=1, seed=seed, vehicles=vehicles, local_origin="pad")


def schema() -> dict[str, Any]:
    """Return the JSON schema of world files, for editors."""
    return World.model_json_schema(by_alias=True)
