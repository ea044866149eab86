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
    Number,
    Text,
    Vehicles,
    Wind,
    Workspace,
)
from swarm.mission.validation import Section, apply_overrides, number, parse_yaml, validate
from swarm.notebook import table


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
