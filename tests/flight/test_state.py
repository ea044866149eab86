"""Every part of a flight's state is frozen, and replaced by one module alone."""

import ast
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import get_type_hints

import pytest

from swarm.flight import state
from swarm.flight.state import OWNERS, FlightState

ROOM = Path(state.__file__).parent


def written(path: Path) -> set[str]:
    """Fields of ``flight`` that a module assigns."""
    targets: list[ast.expr] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Assign):
            targets += node.targets
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets.append(node.target)
    flat = [x for one in targets for x in (one.elts if isinstance(one, ast.Tuple) else [one])]
    return {
        one.attr
        for one in flat
        if isinstance(one, ast.Attribute)
        and (
            (isinstance(one.value, ast.Name) and one.value.id == "flight")
            or (isinstance(one.value, ast.Attribute) and one.value.attr in {"state", *OWNERS})
        )
    }


def test_each_part_has_one_owner():
    modules = {str(p.relative_to(ROOM).with_suffix("")): written(p) for p in ROOM.rglob("*.py")}
    owners = {part: {name for name, parts in modules.items() if part in parts} for part in OWNERS}
    assert owners == {part: {owner} for part, owner in OWNERS.items()}
    elsewhere = set().union(*modules.values()) - set(OWNERS)
    assert not elsewhere, "fields of a flight that are no parts"


@pytest.mark.parametrize("part", OWNERS)
def test_each_part_is_frozen(part):
    hint = get_type_hints(FlightState)[part]
    kinds = [kind for kind in getattr(hint, "__args__", (hint,)) if is_dataclass(kind)]
    assert kinds
    assert all(kind.__dataclass_params__.frozen for kind in kinds)


def test_what_has_no_owner_is_never_replaced():
    kept = {field.name for field in fields(FlightState)} - set(OWNERS)
    assert kept == {
        "setup", "team", "preparation", "clock", "guidance", "detectors", "recorder", "_phase"
    }  # fmt: skip
