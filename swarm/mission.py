"""The mission: what to tie, in which cable, with which vehicles, under which margins.

Text in, a frozen :class:`Mission` out; every error with its key path. Reading the file is the
shell's work.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from swarm.errors import InputError, Problem
from swarm.notebook import table
from swarm.validation import Section, apply_overrides, number, parse_yaml, validate

Auto = Literal["auto"]
Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0)]
NotNegative = Annotated[float, Field(strict=True, ge=0)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=20_000)]
Point2 = tuple[Number, Number]
Point3 = tuple[Number, Number, Number]


def _length(default: Any, sentence: str, **bounds: Any) -> Any:
    return number(default, "metres", sentence, kind="a length", **(bounds or {"above": 0}))


class Knot(Section):
    """Which knot: one of a name, a Gauss code, a DT code, a PD code or a grid diagram."""

    name: Text | None = Field(
        None, description="A knot's name: overhand, figure-eight, 8_18, torus(2,5), 3_1#m3_1."
    )
    gauss: Text | None = Field(
        None, description='A Gauss code: "1- 2+ 3- 1+ 2- 3+", + passes over, - passes under.'
    )
    dt: tuple[int, ...] | None = Field(None, description="A Dowker-Thistlethwaite code.")
    pd: tuple[tuple[int, int, int, int], ...] | None = Field(
        None, description="A planar diagram code, four strands per crossing."
    )
    grid: tuple[tuple[int, int], ...] | None = Field(
        None, description="A grid diagram: the two rows of each column; columns pass over."
    )
    chirality: Literal["left", "right", "either"] | None = Field(
        None,
        description="Which mirror image to tie. Must be said where the knot is chiral and the "
        "code does not fix it.",
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

    mass_per_length: Number = number(0.012, "kg/m", "Mass of a metre of cable.", above=0)
    diameter: Number = _length(0.006, "Thickness of the cable.")
    length_tolerance: Number = _length(
        0.01, "How far a segment's length may be off, each.", least=0
    )
    length: Number | None = _length(
        None, "Total length of the cable at hand; the layout is rescaled to use it."
    )
    breaking_load: Number = number(200.0, "newtons", "Load at which the cable breaks.", above=0)


class Vehicles(Section):
    """What every vehicle of the team can do, and how well."""

    radius: Number = _length(0.25, "From the vehicle's axis to its rotor tips.")
    grip_offset: Number = _length(
        0.6, "Height of the vehicle's centre above its grip point.", least=0
    )
    max_speed: Number = number(2.0, "m/s", "Largest planned speed.", above=0)
    max_acceleration: Number = number(2.0, "m/s²", "Largest planned acceleration.", above=0)
    braking_acceleration: Number = number(
        1.0, "m/s²", "Part of the acceleration kept for stopping along the path.", above=0
    )
    payload: Number = number(0.4, "kg", "Mass that a vehicle can carry beside itself.", above=0)
    mass: Number = number(1.5, "kg", "Mass of a vehicle.", above=0)
    tracking: Number = _length(
        0.1, "Radius of the ball around the setpoint within which a grip point stays.", least=0
    )
    endurance: Number = number(600.0, "s", "Flight time on one battery, with load.", above=0)
    breakaway: Number | None = number(
        None, "newtons", "Pull at which a tied-on cable lets go (grab: attached).", above=0
    )

    @model_validator(mode="after")
    def _reserve(self) -> Self:
        if self.braking_acceleration >= self.max_acceleration:
            raise ValueError(
                "expected braking_acceleration below max_acceleration "
                f"({self.max_acceleration:g} m/s²), got {self.braking_acceleration:g}"
            )
        return self


class Layout(Section):
    """Where the knot's corners lie in space: numbers as they are, or ``auto``."""

    cell: Positive | Auto = _length("auto", "Width of a grid cell.", above=0, auto=True)
    sag_over: Positive | Auto = _length(
        "auto", "Sag of the segments that pass over.", above=0, auto=True
    )
    sag_under: Positive | Auto = _length(
        "auto", "Sag of the segments that pass under.", above=0, auto=True
    )
    lane_over: NotNegative | Auto = _length(
        "auto", "Height of the over lanes above the knot's plane.", least=0, auto=True
    )
    lane_under: NotNegative | Auto = _length(
        "auto", "Depth of the under lanes below the knot's plane.", least=0, auto=True
    )
    height: Positive | Auto = _length(
        "auto", "Height of the knot's plane above the floor.", above=0, auto=True
    )
    corners: tuple[Point2, ...] | None = Field(
        None, description="Corners in plan view in order along the cable, instead of a grid's."
    )
    sags: tuple[Number, ...] | None = Field(
        None, description="One sag per segment in metres, with `corners`."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.sags is not None and self.corners is None:
            raise ValueError("expected sags only together with corners")
        if self.corners is not None:
            unused = [
                name
                for name in ("sag_over", "sag_under", "lane_over", "lane_under")
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
    """Distances to keep, whatever the tracking errors within the ball do."""

    cable: Number = _length(0.15, "Between strands, surface to surface.")
    vehicle: Number = _length(1.0, "Between vehicles horizontally, centre to centre, or …")
    downwash: Number = _length(1.5, "… between vehicles vertically, centre to centre.")
    vehicle_cable: Number = _length(0.3, "Between a vehicle and other segments' cable.")
    floor: Number = _length(0.5, "Between cable aloft and the floor.", least=0)


class Wind(Section):
    """The wind that the flight must withstand."""

    steady: Number = number(0.0, "m/s", "Steady wind, from any direction.", least=0, kind="a speed")
    gust: Number = number(0.0, "m/s", "Gusts on top of it.", least=0, kind="a speed")


class Workspace(Section):
    """Where the team may fly."""

    ceiling: Number = _length(30.0, "Largest height of a vehicle above the floor.")
    fence: tuple[Point2, ...] | None = Field(
        None, description="Corners of the geofence in plan view (x east, y north, metres)."
    )

    @model_validator(mode="after")
    def _polygon(self) -> Self:
        if self.fence is not None and len(self.fence) < 3:
            raise ValueError(f"expected a fence of at least 3 corners, got {len(self.fence)}")
        return self


class Fold(Section):
    """How the team gets to the knot."""

    method: Literal["certified", "paper"] = Field(
        "certified", description="Our planner, or the published trajectory for comparison."
    )
    delay: Number | None = number(
        None, "s", "Constant delay between vehicles (method: paper).", above=0
    )

    @model_validator(mode="after")
    def _delay_of_the_paper(self) -> Self:
        if self.delay is not None and self.method != "paper":
            raise ValueError(f"expected delay only with method: paper, got {self.method}")
        return self


class Formation(Section):
    """First steps: where grip points go, one formation after the other, and the cable between."""

    places: tuple[tuple[Point3, ...], ...] = Field(
        description="Formations in the order in which they are flown: a grip point x, y, z (metres "
        "east, north, up) for each vehicle, in order along the cable."
    )
    lengths: tuple[Number, ...] = Field(
        (), description="Metres of cable between neighbouring vehicles; none for no cable."
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
    """A mission file, validated."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this format.")
    name: Text = Field(description="What the flight's record is called.")
    knot: Knot | None = Field(None, description="Which knot to tie.")
    formation: Formation | None = Field(
        None, description="Places to fly to with a piece of cable or none, instead of a knot."
    )
    cable: Cable = Field(Cable(), description="The cable to tie it in.")
    vehicles: Vehicles = Field(Vehicles(), description="The vehicles.")
    layout: Layout = Field(Layout(), description="Where the knot lies in space.")
    clearance: Clearance = Field(Clearance(), description="Distances to keep.")
    wind: Wind = Field(Wind(), description="The wind to withstand.")
    workspace: Workspace = Field(Workspace(), description="Where to fly.")
    fold: Fold = Field(Fold(), description="How to get there.")
    start: Literal["line", "serpentine"] = Field(
        "line", description="How the cable lies on the floor."
    )
    grab: Literal["floor", "attached"] = Field(
        "floor", description="Pick the cable up from the floor, or have it tied on by hand."
    )
    hold_time: Number = number(
        4.0, "s", "How long the knot hangs folded before the finish; a strand swings as long.",
        least=4.0,
    )  # fmt: skip
    finish: Literal["release", "unfold", "tighten", "hold"] = Field(
        "release",
        description="What follows the hold: release by all; unfold, back to how the cable lay; "
        "tighten (the inner vehicles let go, the ends pull apart); hold, put down as it hangs.",
    )

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

        A chiral knot is tied right-handed unless its name (m3_1) or ``chirality`` says otherwise.
        ``tracking`` is the tracking error in metres to certify for (``vehicles.tracking``); other
        ``keys`` are those of mission files: ``clearance={"cable": 0.2}``, ``finish="unfold"``.

        Raises :class:`swarm.errors.InputError` with every problem. Whether the knot exists is told
        when it is planned. Source: :class:`Mission`; `swarm schema mission` prints all keys.
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
        """What one line says of a mission, by name."""
        return {
            "task": _task(self),
            "tracking": f"tracking errors up to {self.vehicles.tracking:g} m",
            "finish": f"finish {self.finish}",
        }

    def document(self) -> dict[str, Any]:
        """Return the mission as plain data that makes the same mission again, defaults included.

        Keys that say nothing of a formation are left out, as they must be in a file.
        """
        document = self.model_dump(mode="json", by_alias=True)
        unused: set[str] = set()
        if self.formation is not None:
            unused |= {"layout", "fold"}
            if not self.formation.lengths:
                unused |= {"grab", "finish"}
        return {key: value for key, value in document.items() if key not in unused}

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        if (self.knot is None) == (self.formation is None):
            got = "none" if self.knot is None else "both"
            raise ValueError(f"expected exactly one of knot and formation, got {got}")
        if self.formation is not None:
            self._check_formation(self.formation)
        return self

    def _check_formation(self, formation: Formation) -> None:
        """Refuse what says nothing of a formation rather than to ignore it."""
        unused = sorted(
            [name for name in ("layout", "fold") if name in self.model_fields_set]
            + ["cable.length"] * (self.cable.length is not None)
        )
        if unused:
            raise ValueError(f"expected no {' and no '.join(unused)} with a formation")
        if not formation.lengths:
            carried = sorted({"grab", "finish"} & self.model_fields_set)
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
                "expected cable.length only with a layout that is left to the planner, which it "
                f"rescales, got {wrong} too"
            )
        return self

    @model_validator(mode="after")
    def _tied_on(self) -> Self:
        if self.grab == "attached":
            if self.vehicles.breakaway is None:
                raise ValueError("expected vehicles.breakaway in newtons with grab: attached")
            if self.finish in {"release", "tighten"}:
                raise ValueError(
                    "expected finish: hold or unfold with grab: attached, for nothing lets go of a "
                    f"cable that is tied on, got {self.finish}"
                )
        elif self.vehicles.breakaway is not None:
            raise ValueError("expected vehicles.breakaway only with grab: attached")
        return self


def _task(mission: Mission) -> str:
    """What a mission is for, in a few words."""
    if mission.formation is not None:
        count = len(mission.formation.places)
        return f"{count} formation{'s' if count > 1 else ''}"
    assert mission.knot is not None  # noqa: S101 - a mission has one or the other
    told = mission.knot.model_dump(exclude_none=True)
    hand = told.pop("chirality", "either")
    described, value = next(iter(told.items()))
    task = str(value) if described == "name" else f"a knot given by its {_CODES[described]}"
    return task if hand == "either" else f"{task}, {hand}-handed"


_CODES = {"gauss": "Gauss code", "dt": "DT code", "pd": "PD code", "grid": "grid diagram"}


def parse_mission(text: str, source: str, overrides: Iterable[str] = ()) -> Mission:
    """Turn a mission file's text into a :class:`Mission`.

    ``source`` names the file in errors, ``overrides`` are ``key.path=value`` strings applied to
    the document before it is validated. Raises :class:`swarm.errors.InputError` with every
    problem at once.
    """
    return validate(Mission, apply_overrides(parse_yaml(text, source), overrides), source)


def mission_for_knot(knot: str, overrides: Iterable[str] = ()) -> Mission:
    """Return the default mission for a knot's name, with overrides applied.

    A chiral knot is tied right-handed unless its name (m3_1) or an override says otherwise.
    """
    document = {"schema": 1, "name": knot, "knot": {"name": knot, "chirality": "either"}}
    return validate(Mission, apply_overrides(document, overrides), knot)


def mission_schema() -> dict[str, Any]:
    """Return the JSON schema of mission files, for editors."""
    return Mission.model_json_schema(by_alias=True)
