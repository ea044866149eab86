"""The mission: which knot to tie, in which cable, with which vehicles and margins.

Parses text to a frozen :class:`Mission`. Errors name the key path. This module opens no files.
Codes of knots are lists, or text with brackets, commas and spaces. What cannot be read is returned
unchanged; the validation of the key reports it.
"""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    StringConstraints,
    field_validator,
    model_serializer,
    model_validator,
)

from swarm.errors import InputError, Problem
from swarm.mission.validation import Section, apply_overrides, number, read_model, validate
from swarm.notebook import table

_INTEGER = re.compile(r"[-+]?\d+")
_GROUP = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")


def dt_entries(code: Any) -> Any:
    """Return the entries of a DT code: ``4 6 2``, ``DT:[(4,6,2)]``, ``DTCode[4, 6, 2]``."""
    code = _unbraced(code)
    if not isinstance(code, str):
        return code
    return _integers(re.sub(r"^\s*DT(Code)?\s*:?", "", code, flags=re.IGNORECASE), code)


def pd_rows(code: Any) -> Any:
    """Return the crossings of a PD code such as ``PD[X[1,5,2,4],X[3,1,4,6],X[5,3,6,2]]``."""
    if not isinstance(code, str):
        return code
    return _groups(re.sub(r"PD|X_?", "", code, flags=re.IGNORECASE), 4, code)


def grid_columns(code: Any) -> Any:
    """Return the columns of a grid diagram such as ``[1,3] [2,4] [3,5] [1,4] [2,5]``."""
    return _groups(code, 2, code) if isinstance(code, str) else code


def gauss_text(code: Any) -> Any:
    """Return the text of a Gauss code that is a list, as ``GaussCode[-1, 2, -3, 1, -2, 3]`` is."""
    code = _unbraced(code)
    if isinstance(code, str) and (match := re.fullmatch(r"\s*GaussCode\s*(\[.*\])\s*", code)):
        code = _integers(match[1], code)
    if not isinstance(code, list | tuple) or any(isinstance(entry, list | bool) for entry in code):
        return code
    return " ".join(str(entry) for entry in code)


def _unbraced(code: Any) -> Any:
    """Return the entries of ``{4, 6, 2}``, which YAML reads as a mapping without values."""
    if isinstance(code, dict) and all(value is None for value in code.values()):
        return list(code)
    return code


def _integers(text: str, code: str) -> Any:
    """Return the integers of a text that has only integers, brackets, commas and spaces."""
    numbers = re.sub(r"[\[\](){},;\s]+", " ", text.replace("−", "-")).split()
    if not numbers or any(_INTEGER.fullmatch(each) is None for each in numbers):
        return code
    return tuple(int(each) for each in numbers)


def _groups(text: str, size: int, code: str) -> Any:
    """Return integers in groups: as the innermost brackets have them, or ``size`` at a time."""
    inner = _GROUP.findall(text)
    if len(inner) > 1:
        rest = _GROUP.sub("", text)
        groups = tuple(_integers(each, code) for each in inner)
        return code if re.sub(r"[\[\](){},;\s]", "", rest) else groups
    flat = _integers(text, code)
    if flat == code or len(flat) % size:
        return code
    return tuple(flat[k : k + size] for k in range(0, len(flat), size))


Auto = Literal["auto"]
Number = Annotated[float, Field(strict=True)]
_LARGEST_SIZE = 200.0
"""Largest size of a knot's layout, in metres: the overhand has cells of 1.5 m."""

LARGEST_TRACKING = 5.0
"""Largest tracking error in metres that missions and fleets may have."""

_FARTHEST = 10_000.0
"""Largest coordinate in metres: farther away than an operator sees a vehicle."""

_SHORTEST_NORMAL = 1e-6
"""Least length of a direction, whose square divides numbers without loss."""

Positive = Annotated[float, Field(strict=True, gt=0, le=_LARGEST_SIZE)]
NotNegative = Annotated[float, Field(strict=True, ge=0, le=_LARGEST_SIZE)]
Coordinate = Annotated[float, Field(strict=True, ge=-_FARTHEST, le=_FARTHEST)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=20_000)]
Point2 = tuple[Coordinate, Coordinate]
Point3 = tuple[Coordinate, Coordinate, Coordinate]
DtCode = Annotated[
    tuple[int, ...], BeforeValidator(dt_entries, json_schema_input_type=str | tuple[int, ...])
]
Fours = tuple[tuple[int, int, int, int], ...]
PdCode = Annotated[Fours, BeforeValidator(pd_rows, json_schema_input_type=str | Fours)]
Pairs = tuple[tuple[int, int], ...]
GridCode = Annotated[Pairs, BeforeValidator(grid_columns, json_schema_input_type=str | Pairs)]
GaussCode = Annotated[
    Text,
    BeforeValidator(gauss_text, json_schema_input_type=Text | tuple[int | str, ...]),
]


def _length(default: Any, sentence: str, **bounds: Any) -> Any:
    return number(default, "metres", sentence, kind="a length", **(bounds or {"above": 0}))


def _code(sentence: str, expected: str) -> Any:
    """Declare a key that takes a code of a knot, as a list or as people write it."""
    return Field(None, description=sentence, json_schema_extra={"expected": expected})


class Knot(Section):
    """The knot: exactly one of a name, a Gauss code, a DT code, a PD code or a grid diagram."""

    name: Text | None = Field(
        None,
        description="Name of the knot: overhand, figure-eight, 8_18, torus(2,5), 3_1#m3_1.",
    )
    gauss: GaussCode | None = _code(
        "Gauss code: + passes over, - passes under.", 'a Gauss code such as "1- 2+ 3- 1+ 2- 3+"'
    )
    dt: DtCode | None = _code("Dowker-Thistlethwaite code.", 'a DT code such as "4 6 2"')
    pd: PdCode | None = _code(
        "Planar diagram code: the four edges of each crossing.",
        'a PD code such as "X[1,5,2,4] X[3,1,4,6] X[5,3,6,2]"',
    )
    grid: GridCode | None = _code(
        "Grid diagram: the two rows of each column; columns pass over.",
        'a grid diagram such as "[1,3] [2,4] [3,5] [1,4] [2,5]"',
    )
    chirality: Literal["left", "right", "either"] | None = Field(
        None,
        description="Mirror image to tie. Required where the knot is chiral and the code does "
        "not determine it.",
    )

    @model_validator(mode="after")
    def _one_description(self) -> Self:
        given = [key for key in ("name", "gauss", "dt", "pd", "grid") if getattr(self, key)]
        if len(given) != 1:
            raise ValueError(
                "expected exactly one of name, gauss, dt, pd or grid, got "
                + (" and ".join(given) or "none")
            )
        return self


class Cable(Section):
    """The cable."""

    mass_per_length: Number = number(
        0.012, "kg/m", "Mass per length of the cable.", above=0, most=5.0
    )
    diameter: Number = _length(0.006, "Diameter of the cable.", above=0, most=0.1)
    length_tolerance: Number = _length(
        0.01, "Largest error of the length of each segment.", least=0, most=1.0
    )
    length: Number | None = _length(
        None,
        "Total length of the available cable; the layout is scaled to use it.",
        above=0,
        most=5_000.0,
    )
    breaking_load: Number = number(
        200.0, "newtons", "Tension at which the cable breaks.", above=0, most=1e6
    )


_LARGEST_PAYLOAD = 5.0
"""Largest payload in masses of the vehicle: of the multirotors on sale, heavy-lift vehicles carry
most, about twice their own mass."""


class Vehicles(Section):
    """Number, properties and limits of the vehicles of the team."""

    count: Annotated[int, Field(strict=True, ge=3, le=200)] | Literal["auto", "fewest"] = Field(
        "auto",
        description="Number of vehicles. auto: one for each corner of the grid diagram, 2N − 1; "
        "fewest: the smallest number for which a motion is found; a number: that many, or refused.",
        json_schema_extra={"expected": "auto, fewest or an integer >= 3 and <= 200"},
    )

    radius: Number = _length(
        0.25, "Distance from the vehicle's axis to the tips of its rotors.", above=0, most=5.0
    )
    grip_offset: Number = _length(
        0.6, "Height of the vehicle's centre above its grip point.", least=0, most=20.0
    )
    max_speed: Number = number(2.0, "m/s", "Largest planned speed.", above=0, most=100.0)
    max_acceleration: Number = number(
        2.0, "m/s²", "Largest planned acceleration.", above=0, most=100.0
    )
    braking_acceleration: Number = number(
        1.0,
        "m/s²",
        "Part of the acceleration reserved for braking along the path.",
        above=0,
        most=100.0,
    )
    payload: Number = number(
        0.4, "kg", "Largest mass that a vehicle can carry.", above=0, most=200.0
    )
    mass: Number = number(1.5, "kg", "Mass of a vehicle.", above=0, most=500.0)
    tracking: Number = _length(
        0.1,
        "Largest tracking error: distance of a grip point from its setpoint.",
        least=0,
        most=LARGEST_TRACKING,
    )
    endurance: Number = number(
        600.0, "s", "Flight time on one battery, with payload.", least=60.0, most=86_400.0
    )
    breakaway: Number | None = number(
        None,
        "newtons",
        "Tension at which a tied-on cable releases (grab: attached).",
        above=0,
        most=1e5,
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        problems = []
        if self.braking_acceleration >= self.max_acceleration:
            problems.append(
                "expected braking_acceleration below max_acceleration "
                f"({self.max_acceleration:g} m/s²), got {self.braking_acceleration:g}"
            )
        if self.payload > _LARGEST_PAYLOAD * self.mass:
            problems.append(
                f"expected payload of at most {_LARGEST_PAYLOAD:g} times mass ({self.mass:g} kg), "
                f"got {self.payload:g}: did you mean {1e-3 * self.payload:g}? For a larger vehicle "
                f"give both, for example: vehicles: {{mass: {self.payload:g}, "
                f"payload: {self.payload:g}}}"
            )
        if problems:
            raise ValueError("; ".join(problems))
        return self


class Layout(Section):
    """Size and height of the knot in space: numbers, or ``auto`` for the planner's choice."""

    cell: Positive | Auto = _length(
        "auto", "Width of a cell of the grid.", above=0, most=_LARGEST_SIZE, auto=True
    )
    sag_over: Positive | Auto = _length(
        "auto", "Sag of the segments that pass over.", above=0, most=_LARGEST_SIZE, auto=True
    )
    sag_under: Positive | Auto = _length(
        "auto", "Sag of the segments that pass under.", above=0, most=_LARGEST_SIZE, auto=True
    )
    lane_over: NotNegative | Auto = _length(
        "auto",
        "Height of the over lanes above the knot's plane.",
        least=0,
        most=_LARGEST_SIZE,
        auto=True,
    )
    lane_under: NotNegative | Auto = _length(
        "auto",
        "Depth of the under lanes below the knot's plane.",
        least=0,
        most=_LARGEST_SIZE,
        auto=True,
    )
    chord_margin: NotNegative | Auto = _length(
        "auto",
        "How much farther apart than its corners the ends of a segment can be; auto: 2.2 tracking "
        "errors. More lets a team fly faster: a vehicle without setpoints moves on until it stops.",
        least=0,
        most=10.0,
        auto=True,
    )
    height: Positive | Auto = _length(
        "auto",
        "Height of the knot's plane above the floor.",
        above=0,
        most=_LARGEST_SIZE,
        auto=True,
    )
    corners: tuple[Point2, ...] | None = Field(
        None, description="Corners x, y in metres in order along the cable, instead of the grid's."
    )
    sags: tuple[Number, ...] | None = Field(
        None, description="Sag of each segment in metres, together with `corners`."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.sag_over != "auto" and self.chord_margin != "auto":
            raise ValueError("expected no chord_margin together with sag_over, which decides it")
        if self.sags is not None and self.corners is None:
            raise ValueError("expected sags only together with corners")
        if self.corners is not None:
            unused = [
                name
                for name in ("sag_over", "sag_under", "lane_over", "lane_under", "chord_margin")
                if getattr(self, name) != "auto"
            ]
            if unused:
                raise ValueError(f"expected no {' and no '.join(unused)} together with corners")
            if len(self.corners) < 3:
                raise ValueError(f"expected at least 3 corners, got {len(self.corners)}")
            if self.sags is None or len(self.sags) != len(self.corners) - 1:
                got = "none" if self.sags is None else str(len(self.sags))
                raise ValueError(f"expected {len(self.corners) - 1} sags, got {got}")
            if any(sag <= 0 for sag in self.sags):
                raise ValueError("expected every sag > 0 in metres")
        return self


class Clearance(Section):
    """Clearances to keep for every tracking error up to `vehicles.tracking`."""

    cable: Number = _length(
        0.15, "Distance between strands, surface to surface.", above=0, most=10.0
    )
    vehicle: Number = _length(
        1.0,
        "Horizontal distance between vehicles, centre to centre; `vehicle` or `downwash` is kept.",
        above=0,
        most=50.0,
    )
    downwash: Number = _length(
        1.5,
        "Vertical distance between vehicles, centre to centre; `vehicle` or `downwash` is kept.",
        above=0,
        most=100.0,
    )
    vehicle_cable: Number = _length(
        0.3,
        "Distance between a vehicle and the segments that it does not hold.",
        above=0,
        most=50.0,
    )
    floor: Number = _length(
        0.5, "Distance between the cable aloft and the floor.", least=0, most=100.0
    )
    obstacle: Number = _length(
        0.2, "Distance of vehicles and cable from obstacles.", above=0, most=50.0
    )


class Limits(Section):
    """What a plan must keep to be flown, beside its certificate."""

    accept_negative_budget: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="true: plan without regard to the clearance budget, and fly a plan whose "
        "strands can be closer than `clearance.cable` if all of its effects come together; false: "
        "lead strands apart and slow down for it, and refuse such a plan.",
        json_schema_extra={"expected": "true or false"},
    )


class Wind(Section):
    """The wind that the flight must withstand."""

    steady: Number = number(
        0.0,
        "m/s",
        "Speed of the steady wind, from any direction.",
        least=0,
        most=40.0,
        kind="a speed",
    )
    gust: Number = number(
        0.0,
        "m/s",
        "Speed of gusts in addition to the steady wind.",
        least=0,
        most=60.0,
        kind="a speed",
    )


class _Obstacle(Section):
    name: Annotated[Text, StringConstraints(max_length=60)] = Field(
        description="Name of the obstacle in messages and pictures.", examples=["table"]
    )


class _Upright(_Obstacle):
    bottom: Number = _length(
        0.0, "Height of its lower side above the floor.", least=0, most=5_000.0
    )
    top: Number = _length(..., "Height of its upper side above the floor.", above=0, most=5_000.0)

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.top <= self.bottom:
            raise ValueError(f"expected top > bottom, got {self.top:g} and {self.bottom:g}")
        return self


class BoxObstacle(_Upright):
    """An upright box: a table, a wall, the beam of a truss."""

    shape: Literal["box"] = Field(description="Its shape.", examples=["box"])
    centre: Point2 = Field(description="Its centre x, y in metres (x east, y north).")
    size: tuple[Positive, Positive] = Field(
        description="Its width along x and its depth along y in metres, before it is turned."
    )
    turn: Number = number(
        0.0, "degrees", "Angle by which it is turned to the left, seen from above.",
        least=-360, most=360, kind="an angle",
    )  # fmt: skip


class CylinderObstacle(_Upright):
    """An upright cylinder: a pillar, a tree."""

    shape: Literal["cylinder"] = Field(description="Its shape.")
    centre: Point2 = Field(description="Its axis x, y in metres (x east, y north).")
    radius: Number = _length(..., "Its radius.", above=0, most=_LARGEST_SIZE)


class HalfSpaceObstacle(_Obstacle):
    """All behind a plane: a net, a wall, a roof."""

    shape: Literal["half-space"] = Field(description="Its shape.")
    point: Point3 = Field(description="A point x, y, z of the plane in metres.")
    normal: Point3 = Field(
        description="Direction x, y, z from the plane to the free side, of any length >= 1e-6."
    )

    @field_validator("normal")
    @classmethod
    def _directed(cls, normal: Point3) -> Point3:
        if math.hypot(*normal) < _SHORTEST_NORMAL:
            x, y, z = normal
            raise ValueError(
                f"expected a normal of length >= {_SHORTEST_NORMAL:g}, got {x:g}, {y:g}, {z:g}"
            )
        return normal


Obstacle = Annotated[
    BoxObstacle | CylinderObstacle | HalfSpaceObstacle, Field(discriminator="shape")
]


class Workspace(Section):
    """The space in which the team may fly."""

    ceiling: Number = _length(
        30.0, "Largest height of a vehicle above the floor.", above=0, most=5_000.0
    )
    fence: tuple[Point2, ...] | None = Field(
        None, description="Corners x, y of the geofence in metres (x east, y north)."
    )
    obstacles: tuple[Obstacle, ...] = Field(
        (),
        description="What stands in this space, such as nets, trusses and tables: vehicles and "
        "cable keep `clearance.obstacle` from it.",
        max_length=200,
    )

    @model_validator(mode="after")
    def _polygon(self) -> Self:
        if self.fence is not None and len(self.fence) < 3:
            raise ValueError(f"expected a fence of at least 3 corners, got {len(self.fence)}")
        return self

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        names = [obstacle.name for obstacle in self.obstacles]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"expected a name of its own for each obstacle, got {twice[0]} twice")
        return self


class Fold(Section):
    """How the team folds the knot."""

    method: Literal["certified", "optimised", "paper"] = Field(
        "certified",
        description="certified: all vehicles follow one curve; optimised: a third to half as long, "
        "by one optimisation of all motions, which takes half a minute for nine vehicles and "
        "leaves room for the wind of the mission, hardly for more; paper: the published "
        "trajectory, for comparison.",
    )
    delay: Number | None = number(
        None, "s", "Delay between neighbouring vehicles (method: paper).", above=0, most=600.0
    )
    swing: Annotated[float, Field(strict=True, gt=0, le=10.0)] | Auto = _length(
        "auto",
        "Largest distance of the swinging cable from its catenary in the planned fold, which is "
        "shaped and slowed for it. In metres, the clearances hold around the catenary too, as far "
        "as the cable swings in the planned motion and after one ordinary stop with the resume "
        "that follows. auto: 0.95 % of the longest segment, 1 % with fewer vehicles than the grid "
        "diagram has corners, at least 0.06 m, as far as slowing reaches that within the "
        "endurance.",
        above=0,
        most=10.0,
        auto=True,
    )

    @property
    def certifies_swing(self) -> bool:
        """Whether clearances are certified for a swinging cable: ``swing`` is in metres."""
        return self.swing != "auto"

    @model_validator(mode="after")
    def _keys_of_the_method(self) -> Self:
        if self.delay is not None and self.method != "paper":
            raise ValueError(f"expected delay only with method: paper, got {self.method}")
        if self.swing != "auto" and self.method == "paper":
            raise ValueError("expected swing only with method: certified or optimised, got paper")
        return self


class Formation(Section):
    """Formations of grip points to fly one after the other, instead of a knot."""

    places: tuple[tuple[Point3, ...], ...] = Field(
        description="Formations in flight order, each with a grip point x, y, z (metres east, "
        "north, up) for each vehicle in order along the cable."
    )
    lengths: tuple[Number, ...] = Field(
        (),
        description="Length of the cable between neighbouring vehicles in metres; empty: no cable.",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.places or not self.places[0]:
            raise ValueError("expected at least one formation of at least one vehicle, got none")
        count = len(self.places[0])
        for place_in_order, places in enumerate(self.places, start=1):
            if len(places) != count:
                raise ValueError(
                    f"expected {count} places in every formation, got {len(places)} in the "
                    f"{place_in_order}."
                )
            if any(place[2] <= 0 for place in places):
                raise ValueError("expected every place above the floor (z > 0)")
        if self.lengths and len(self.lengths) != count - 1:
            raise ValueError(
                f"expected {count - 1} lengths for {count} vehicles (or none), got "
                f"{len(self.lengths)}"
            )
        if any(length <= 0 for length in self.lengths):
            raise ValueError("expected every length > 0 in metres")
        return self


class Mission(Section):
    """A mission: the validated content of a mission file."""

    schema_version: Literal[1] = Field(
        alias="schema", description="Version of this format.", examples=[1]
    )
    name: Text = Field(
        description="Name of the mission and of its flight records.", examples=["overhand"]
    )
    knot: Knot | None = Field(None, description="The knot to tie.")
    formation: Formation | None = Field(
        None, description="Formations to fly, with or without cable, instead of a knot."
    )
    cable: Cable = Field(Cable(), description="Properties of the cable.")
    vehicles: Vehicles = Field(Vehicles(), description="The vehicles.")
    layout: Layout = Field(Layout(), description="Size and height of the knot in space.")
    clearance: Clearance = Field(Clearance(), description="Clearances to keep.")
    limits: Limits = Field(Limits(), description="What a plan must keep, beside the certificate.")
    wind: Wind = Field(Wind(), description="Wind that the flight must withstand.")
    workspace: Workspace = Field(Workspace(), description="Limits of the space for the flight.")
    fold: Fold = Field(Fold(), description="Method of folding.")
    start: Literal["line", "serpentine"] = Field(
        "line",
        description="Shape of the cable on the floor before the flight; only line is planned.",
    )
    grab: Literal["floor", "attached"] = Field(
        "floor",
        description="floor: vehicles grip the cable on the floor; attached: it is tied on by hand.",
    )
    lay: Literal["straight", "slack"] = Field(
        "straight",
        description="The cable on the floor (grab: floor). straight: almost taut, and the vehicles "
        "contract it there; slack: each segment folded back on itself in its middle, so that they "
        "grip it where the fold begins.",
    )
    hold_time: Number = number(
        4.0, "s", "Duration of the hold before the finish; the strands swing as long.",
        least=4.0, most=3600.0,
    )  # fmt: skip
    finish: Literal["release", "unfold", "tighten", "hold"] = Field(
        "release",
        description="Phases after the hold. release: all vehicles release aloft; unfold: the "
        "flight backwards, to the cable on the floor; tighten: the inner vehicles release, the two "
        "at the ends pull; hold: a common descent, release on the floor.",
    )

    @model_serializer(mode="wrap")
    def _without_later_keys(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out obstacles, where there are none, and a straight lay: such missions stay what
        they were.

        Digests, plan files and records have all other keys, with their defaults.
        """
        document: dict[str, Any] = serialize(self)
        if self.lay == "straight":
            document.pop("lay", None)
        if not self.workspace.obstacles:
            for section, key in (("workspace", "obstacles"), ("clearance", "obstacle")):
                document.get(section, {}).pop(key, None)
        return document

    @classmethod
    def for_knot(
        cls,
        knot: str,
        *,
        chirality: Literal["left", "right", "either"] = "either",
        tracking: float | None = None,
        **keys: Any,
    ) -> Self:
        """Return the default mission for a knot's name, such as "3_1", "overhand" or "3_1#m3_1".

        A chiral knot is tied right-handed unless its name (m3_1) or ``chirality`` selects the
        other. ``tracking`` is the largest certified tracking error in metres
        (``vehicles.tracking``); other ``keys`` are keys of mission files:
        ``clearance={"cable": 0.2}``, ``finish="unfold"``.

        Raises :class:`swarm.errors.InputError` with every problem, but not for an unknown knot:
        planning does. Source: :class:`Mission`; `swarm schema mission` prints all keys.
        """
        described = {"name": knot, "chirality": chirality}
        document: dict[str, Any] = {"schema": 1, "name": knot, "knot": described}
        for key, value in keys.items():
            document[key] = value.model_dump() if isinstance(value, Section) else value
        vehicles = document.get("vehicles", {})
        if tracking is not None and isinstance(vehicles, Mapping):
            if "tracking" in vehicles:
                message = "expected this key or tracking, got both"
                raise InputError([Problem(f"{knot}: vehicles.tracking", message)])
            document["vehicles"] = {**vehicles, "tracking": tracking}
        return validate(cls, document, knot)

    def __repr__(self) -> str:
        return f"<Mission {self.name}: {', '.join(self._figures().values())}>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return table(f"Mission {self.name}", self._figures().items())

    def _figures(self) -> dict[str, str]:
        """Return the figures for one line, by name."""
        return {
            "task": _task(self),
            "tracking": f"tracking errors up to {self.vehicles.tracking:g} m",
            "finish": f"finish {self.finish}",
        }

    def document(self) -> dict[str, Any]:
        """Return the mission as plain data that gives the same mission, with defaults.

        Keys that do not apply to a formation are left out, as in a file.
        """
        document = self.model_dump(mode="json", by_alias=True)
        unused: set[str] = set()
        if self.formation is not None:
            unused |= {"layout", "fold"}
            if not self.formation.lengths:
                unused |= {"grab", "lay", "finish"}
        return {key: value for key, value in document.items() if key not in unused}

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        if (self.knot is None) == (self.formation is None):
            got = "none" if self.knot is None else "both"
            raise ValueError(
                f"expected exactly one of knot and formation, got {got}; for example: "
                "knot: {name: overhand}"
            )
        if self.formation is not None:
            self._check_formation(self.formation)
        return self

    def _check_formation(self, formation: Formation) -> None:
        """Refuse keys that do not apply to a formation, rather than ignore them."""
        unused = sorted(
            [name for name in ("layout", "fold") if name in self.model_fields_set]
            + ["cable.length"] * (self.cable.length is not None)
        )
        if unused:
            raise ValueError(f"expected no {' and no '.join(unused)} with a formation")
        if not formation.lengths:
            carried = sorted({"grab", "lay", "finish"} & self.model_fields_set)
            if carried:
                raise ValueError(
                    f"expected no {' and no '.join(carried)} in a formation without cable"
                )
        elif self.finish == "tighten" and len(formation.lengths) < 2:
            raise ValueError("expected finish: tighten with three vehicles or more, got two")

    @model_validator(mode="after")
    def _cable_at_hand(self) -> Self:
        given = [
            name
            for name in ("cell", "lane_over", "lane_under")
            if getattr(self.layout, name) != "auto"
        ]
        if self.layout.corners is not None:
            given.insert(0, "corners")
        if self.cable.length is not None and (given or self.fold.method == "paper"):
            wrong = f"layout.{given[0]}" if given else "fold.method: paper"
            raise ValueError(
                "expected cable.length only with a layout that the planner chooses and scales, "
                f"got {wrong} too"
            )
        return self

    @model_validator(mode="after")
    def _counted(self) -> Self:
        if self.vehicles.count == "auto":
            return self
        wrong = [f"layout.{name}" for name in sorted(self.layout.model_fields_set - {"height"})]
        wrong += ["cable.length"] * (self.cable.length is not None)
        wrong += ["formation"] * (self.formation is not None)
        wrong += ["fold.method: paper"] * (self.fold.method == "paper")
        wrong = [name for name in wrong if not self._is_auto(name)]
        if wrong:
            raise ValueError(
                f"expected vehicles.count: auto with {wrong[0]}, got {self.vehicles.count}"
            )
        return self

    def _is_auto(self, name: str) -> bool:
        """Return whether a key of the layout is written out with its default."""
        section, _, key = name.partition(".")
        return section == "layout" and getattr(self.layout, key) in {"auto", None}

    @model_validator(mode="after")
    def _tied_on(self) -> Self:
        if self.grab == "attached":
            if self.vehicles.breakaway is None:
                raise ValueError(
                    "expected vehicles.breakaway in newtons with grab: attached; for example: "
                    "vehicles: {breakaway: 5}"
                )
            if self.finish in {"release", "tighten"}:
                raise ValueError(
                    "expected finish: hold or unfold with grab: attached, because a tied-on cable "
                    f"is not released, got {self.finish}"
                )
            if self.lay == "slack":
                raise ValueError("expected lay: slack only with grab: floor, got grab: attached")
        elif self.vehicles.breakaway is not None:
            raise ValueError("expected vehicles.breakaway only with grab: attached")
        return self


def _task(mission: Mission) -> str:
    """Return the task of a mission in a few words."""
    if mission.formation is not None:
        count = len(mission.formation.places)
        return f"{count} formation{'s' if count > 1 else ''}"
    assert mission.knot is not None  # noqa: S101 - a mission has one or the other
    knot = mission.knot.model_dump(exclude_none=True)
    chirality = knot.pop("chirality", "either")
    described, value = next(iter(knot.items()))
    task = str(value) if described == "name" else f"a knot given by its {_CODES[described]}"
    return task if chirality == "either" else f"{task}, {chirality}-handed"


_CODES = {"gauss": "Gauss code", "dt": "DT code", "pd": "PD code", "grid": "grid diagram"}


def parse_mission(text: str, source: str, overrides: Iterable[str] = ()) -> Mission:
    """Return the mission of a mission file's text.

    ``source`` names the file in errors, ``overrides`` are ``key.path=value`` strings applied to
    the document before it is validated. Raises :class:`swarm.errors.InputError` with every
    problem at once.
    """
    return read_model(Mission, text, source, overrides)


def mission_for_knot(knot: str, overrides: Iterable[str] = ()) -> Mission:
    """Return the default mission for a knot's name, with overrides applied.

    A chiral knot is tied right-handed unless its name (m3_1) or an override selects the other.
    """
    document = {"schema": 1, "name": knot, "knot": {"name": knot, "chirality": "either"}}
    return validate(Mission, apply_overrides(document, overrides), knot)


def mission_schema() -> dict[str, Any]:
    """Return the JSON schema of mission files, for editors."""
    return Mission.model_json_schema(by_alias=True)
