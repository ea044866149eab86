"""Which vehicles fly with which firmware: the text of ``--firmware`` to values."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from sitl.world import Kind, World

_PART = re.compile(r"(?:(\d+)\*)?(\w+)=(.+)")
KINDS: tuple[Kind, ...] = ("ardupilot",)
"""The autopilots whose firmware the world can drive."""


class FirmwareError(Exception):
    """An invalid ``--firmware``; the text says what was expected."""


@dataclass(frozen=True)
class Firmware:
    """One part of ``--firmware``: the autopilot, its program, and for how many vehicles."""

    kind: Kind
    program: Path
    count: int | None


def parse(text: str) -> list[Firmware]:
    """Return the parts of ``KIND=PATH`` or ``COUNT*KIND=PATH,…``; raise `FirmwareError`."""
    parts = []
    for part in text.split(","):
        match = _PART.fullmatch(part.strip())
        if match is None or match[2] not in KINDS:
            raise FirmwareError(
                f"--firmware: expected {' or '.join(f'{kind}=PATH' for kind in KINDS)}, got {part}"
            )
        count, name, program = match.groups()
        kind = KINDS[KINDS.index(name)]
        path = Path(program).expanduser().absolute()
        if not (path.is_file() and os.access(path, os.X_OK)):
            raise FirmwareError(
                f"--firmware: expected the program of {kind}, built as its own pages say, got "
                f"{program}: no executable file"
            )
        if count is not None and int(count) < 1:
            raise FirmwareError(f"--firmware: expected a count from 1, got {part}")
        parts.append(Firmware(kind, path, int(count) if count else None))
    return parts


def assign(parts: list[Firmware], world: World) -> dict[int, Firmware]:
    """Return the firmware of each system id that flies with one.

    A part with a count takes as many vehicles of its kind, in order; without one, all that are
    left. Raises `FirmwareError` if there are fewer, or for a cable without inertia: it answers
    each motion of a grip at once, which no control loop in steps stands.
    """
    if parts and world.cable is not None and world.cable.model != "swinging":
        raise FirmwareError(
            f"--firmware: expected a world with cable.model: swinging, got {world.cable.model}"
        )
    vehicles = [(spec.id, spec.autopilot) for spec in world.vehicles]
    chosen: dict[int, Firmware] = {}
    for part in parts:
        free = [system for system, kind in vehicles if kind == part.kind and system not in chosen]
        if len(free) < (part.count or 1):
            raise FirmwareError(
                f"--firmware: expected at least {part.count or 1} vehicles with {part.kind}, "
                f"got {len(free)}"
            )
        chosen |= dict.fromkeys(free[: part.count], part)
    return chosen
