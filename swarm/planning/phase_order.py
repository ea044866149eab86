"""The one order of phases, and what it declares: when the cable is gripped, held and let go of.

A phase's name only says which part of a flight it claims to be. The order is a table of what may
follow what; from a legal order follow the grip, the release and what the cable is supposed to do
in each phase. Whether the motion really does that is for the certificate to check.
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
"""What may come after each phase; a phase may also be the last one. None comes twice."""

FIRST_PHASES: tuple[PhaseName, ...] = ("takeoff", "grab", "contract", "lift", "fold", "hold")
"""What a motion may begin with; the cable is held from its start unless it is gripped later."""


def phase_order_error(before: PhaseName | None, name: PhaseName) -> str | None:
    """Return what is wrong with ``name`` after the phase ``before`` (None: at the start), if it is.

    The answer reads like ``expected hold or finish after fold, got grab``.
    """
    allowed = FIRST_PHASES if before is None else SUCCESSORS[before]
    if name in allowed:
        return None
    wanted = " or ".join(filter(None, (", ".join(allowed[:-1]), *allowed[-1:]))) or "nothing"
    place = "first" if before is None else f"after {before}"
    return f"expected {wanted} {place}, got {name}"


@dataclass(frozen=True)
class DeclaredCable:
    """What a legal order of phases declares.

    ``cable`` says for every phase what the cable is supposed to do. The cable is held from the
    start of phase ``held_from`` to the start of phase ``held_until`` (indices; the number of phases
    where it is never let go of). ``gripped_by_vehicles`` says whether vehicles grip it in flight;
    ``inner_first`` whether the inner vehicles let go first and the two at the ends after the next
    phase.
    """

    cable: tuple[CableState, ...]
    held_from: int
    held_until: int
    gripped_by_vehicles: bool
    inner_first: bool


def declared_cable(names: Sequence[PhaseName], *, attached: bool) -> DeclaredCable:
    """Return what phases in a legal order declare.

    ``attached`` means that the cable is tied on: then nothing lets go of it at the end of a common
    descent. A take-off that a lift follows takes off with the cable.
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


def _state(name: PhaseName, before: PhaseName | None, unheld: bool, let_go: bool) -> CableState:
    if let_go:
        return "free"
    if name == "land":
        return "landing" if before == "descend" else "lifting"
    if name == "takeoff" and not unheld:
        return "lifting"
    return _SUPPOSED[name]


_SUPPOSED: Mapping[PhaseName, CableState] = {
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
    """Return the finish that phases have; None where the cable is held to the end of the fold."""
    for name in names:
        match name:
            case "unfold" | "tighten":
                return name
            case "descend":
                return "hold"
            case "finish":
                return "release"
    return None
