"""The mission: which knot to tie, in which cable, with which vehicles and margins.

Parses text to a frozen :class:`Mission`. Errors name the key path. This module opens no files.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from swarm.errors import InputError, Problem
from swarm.mission.sections import (
    Cable,
    Clearance,
    Fold,
    Formation,
    Knot,
    Layout,
    Limits,
    Number,
    Text,
    Vehicles,
    Wind,
    Workspace,
)
from swarm.mission.validation import Section, apply_overrides, number, parse_yaml, validate
from swarm.notebook import table


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
                unused |= {"grab", "finish"}
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
    overrides = tuple(overrides)
    document = apply_overrides(parse_yaml(text, source), overrides)
    return validate(Mission, document, source, text, overrides)


def mission_for_knot(knot: str, overrides: Iterable[str] = ()) -> Mission:
    """Return the default mission for a knot's name, with overrides applied.

    A chiral knot is tied right-handed unless its name (m3_1) or an override selects the other.
    """
    document = {"schema": 1, "name": knot, "knot": {"name": knot, "chirality": "either"}}
    return validate(Mission, apply_overrides(document, overrides), knot)


def mission_schema() -> dict[str, Any]:
    """Return the JSON schema of mission files, for editors."""
    return Mission.model_json_schema(by_alias=True)
