"""The order of phases, and the grip, release and cable states that it declares.

A table lists the phases that may follow each phase. A valid order determines when the cable is
gripped and released, and the cable state of each phase. The certificate checks whether the motion
agrees with that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from swarm.planning.plan import CableState, PhaseName

SUCCESSORS: Mapping[PhaseName, tuple[PhaseName, ...]] = {
    "takeoff": ("grab", "lift"),
    "grab": ("contract",),
    "contract": ("lift",),
    "lift": ("fold",),
    "fold": ("hold", "unfold", "descend", "tighten", "finish"),
    "hold": ("unfold", "descend", "tighten", "finish"),
    "unfold": ("lower",),
    "lower": ("spread", "land"),
    "spread": ("finish",),
    "descend": ("land",),
    "tighten": ("finish",),
    "finish": ("land",),
    "land": (),
}
"""Phases that may follow each phase. Any phase may be the last one; no phase occurs twice."""

FIRST_PHASES: tuple[PhaseName, ...] = ("takeoff", "grab", "contract", "lift", "fold", "hold")
"""Phases that may be the first; the cable is held from the start unless it is gripped later."""


def phase_order_error(before: PhaseName | None, name: PhaseName) -> str | None:
    """Return why phase ``name`` cannot follow phase ``before`` (None: be the first), or None.

    The message is like ``expected hold or finish after fold, got grab``.
    """
    allowed = FIRST_PHASES if before is None else SUCCESSORS[before]
    if name in allowed:
        return None
    expected = " or ".join(filter(None, (", ".join(allowed[:-1]), *allowed[-1:]))) or "nothing"
    place = "first" if before is None else f"after {before}"
    return f"expected {expected} {place}, got {name}"


@dataclass(frozen=True)
class DeclaredCable:
    """The state of the cable that a valid order of phases declares.

    ``cable`` is the cable state of every phase. The cable is held from the start of phase
    ``held_from`` to the start of phase ``held_until`` (indices; the number of phases where it is
    never released). ``gripped_by_vehicles`` states whether vehicles grip it in flight;
    ``inner_first`` whether the inner vehicles release first, and the two end vehicles one phase
    later.
    """

    cable: tuple[CableState, ...]
    held_from: int
    held_until: int
    gripped_by_vehicles: bool
    inner_first: bool


def declared_cable(names: Sequence[PhaseName], *, attached: bool) -> DeclaredCable:
    """Return the state of the cable that phases in a valid order declare.

    ``attached`` means that the cable is tied on and not released at the end of a common descent.
    Where a lift follows the take-off, vehicles take off with the cable.
    """
    tied_on = tuple(names[:2]) == ("takeoff", "lift") or (attached and "grab" not in names)
    cable: list[CableState] = []
    held_from, held_until = 0, len(names)
    for index, name in enumerate(names):
        unheld = name == "grab" or (name == "takeoff" and not tied_on)
        if unheld:
            held_from = index + 1
        released = name in {"tighten", "finish"} or (
            name == "land" and names[index - 1] == "descend" and not attached
        )
        if released:
            held_until = min(held_until, index)
        cable.append(_state(name, names[index - 1] if index else None, unheld, index >= held_until))
    return DeclaredCable(
        tuple(cable), held_from, held_until, held_from > 0, "tighten" in names[held_until:]
    )


def _state(name: PhaseName, before: PhaseName | None, unheld: bool, released: bool) -> CableState:
    if released:
        return "free"
    if name == "land":
        return "landing" if before == "descend" else "lifting"
    if name == "takeoff" and not unheld:
        return "lifting"
    return _CABLE_STATES[name]


_CABLE_STATES: Mapping[PhaseName, CableState] = {
    "takeoff": "floor",
    "grab": "floor",
    "contract": "floor",
    "lift": "lifting",
    "fold": "aloft",
    "hold": "aloft",
    "unfold": "aloft",
    "lower": "lifting",
    "spread": "floor",
    "descend": "landing",
}


def finish_of(names: Sequence[PhaseName]) -> Literal["release", "unfold", "tighten", "hold"] | None:
    """Return the finish of a sequence of phases; None where it ends with the fold or the hold."""
    for name in names:
        match name:
            case "unfold" | "tighten":
                return name
            case "descend":
                return "hold"
            case "finish":
                return "release"
    return None
