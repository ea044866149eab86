"""Which vehicles fly with which firmware: the text of ``--firmware`` to values."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from sitl.firmware.positioning import Positioning, usable
from sitl.world import Kind, World

PX4_PROGRAM = "bin/px4"
"""PX4's program in the folder of its build."""
_PART = re.compile(r"(?:(\d+)\*)?(\w+)=(.+)")
_EXPECTED = {"px4": "BUILD_FOLDER", "ardupilot": "PATH"}
"""The autopilots whose firmware the world can drive, and what names their programs."""
_KINDS: tuple[Kind, ...] = ("px4", "ardupilot")


class FirmwareError(Exception):
    """An invalid ``--firmware``; the text says what was expected."""


@dataclass(frozen=True)
class Firmware:
    """One part of ``--firmware``: the autopilot, its program, and for how many vehicles.

    ``program`` of PX4 is the folder of its build.
    """

    kind: Kind
    program: Path
    count: int | None


def parse(text: str) -> list[Firmware]:
    """Return the parts of ``KIND=PATH`` or ``COUNT*KIND=PATH,…``; raise `FirmwareError`."""
    parts = []
    for part in text.split(","):
        match = _PART.fullmatch(part.strip())
        if match is None or match[2] not in _KINDS:
            known = " or ".join(f"{kind}={what}" for kind, what in _EXPECTED.items())
            raise FirmwareError(f"--firmware: expected {known}, got {part}")
        count, name, program = match.groups()
        kind = _KINDS[_KINDS.index(name)]
        path = _program(kind, program)
        if count is not None and int(count) < 1:
            raise FirmwareError(f"--firmware: expected a count from 1, got {part}")
        parts.append(Firmware(kind, path, int(count) if count else None))
    return parts


def _program(kind: Kind, given: str) -> Path:
    """Return the program of an autopilot, or the folder of a PX4 build; raise `FirmwareError`."""
    path = Path(given).expanduser().absolute()
    file = path / PX4_PROGRAM if kind == "px4" else path
    if file.is_file() and os.access(file, os.X_OK):
        return path
    what = "the folder of a build" if kind == "px4" else "the program"
    lacks = f"no executable {PX4_PROGRAM} in it" if kind == "px4" else "no executable file"
    raise FirmwareError(
        f"--firmware: expected {what} of {kind}, built as its own pages say, got {given}: {lacks}"
    )


def check_positioning(parts: list[Firmware], positioning: Positioning) -> None:
    """Raise `FirmwareError` for firmware that cannot know its position in this way here."""
    if any(not usable(part.kind, positioning) for part in parts):
        raise FirmwareError(f"--positioning: expected rtk or mocap with px4, got {positioning}")


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
