"""Plans that were computed before, in the user's cache.

An entry is a plan file. Its name is a digest of the mission, of the sources of the planner and of
its libraries, so that another version plans again. An entry is certified again when it is read, e*
and w* too: it saves the search for the plan and for their largest values, and no check. Several
processes may use the folder at the same time.
"""

import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import scipy

from swarm import jit
from swarm.errors import InputError, SwarmError
from swarm.front.plan_files import LARGEST_PLAN, certified_plan_file, checks, read_certified
from swarm.mission import Mission
from swarm.planner import PlanningResult

Progress = Callable[[str, float], None]

VARIABLE: Final = "SWARM_PLANS"
"""Environment variable with another folder; empty: no plan is kept."""
KEPT: Final = 14 * 86400.0
"""Seconds for which a plan is kept after it was computed, as long as unused machine code."""
MOST_BYTES: Final = 200 * 1024 * 1024
"""Size of the folder from which the oldest plans are removed: about 80 of nineteen vehicles."""


def find(
    mission: Mission, progress: Progress | None = None
) -> tuple[PlanningResult, datetime] | None:
    """Return the plan of a mission and the time at which it was computed; None if there is none.

    An entry that is not exactly what was written is removed.
    """
    path = _path(mission)
    if path is None:
        return None
    try:
        data, computed = path.read_bytes(), path.stat().st_mtime
    except OSError:
        return None
    if not 0.0 <= time.time() - computed <= KEPT or len(data) > LARGEST_PLAN:
        return None
    try:
        planned, notice = read_certified(data, str(path), progress)
        if notice or planned.plan.mission != mission:
            raise InputError("the plan of another mission or version")
    except SwarmError:
        with suppress(OSError):
            path.unlink()
        return None
    return planned, datetime.fromtimestamp(computed, UTC)


def store(mission: Mission, planned: PlanningResult) -> None:
    """Keep a cleared plan of a mission; without effect where the folder cannot be written."""
    path = _path(mission)
    if path is None or not planned.certificate.cleared:
        return
    data = certified_plan_file(planned.certified())
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Replaced in one step: another process reads the whole entry or none.
        descriptor, name = tempfile.mkstemp(prefix="new-", dir=path.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
            os.replace(name, path)
        except OSError:
            with suppress(OSError):
                os.unlink(name)
        _prune(path.parent)


def _path(mission: Mission) -> Path | None:
    """Return the path of a mission's entry; None where no plan is kept."""
    given = os.environ.get(VARIABLE)
    if given == "":
        return None
    name = _key(mission)
    if name is None:
        return None
    return (Path(given) if given else jit.cache() / "plans") / f"{name}.plan"


def _key(mission: Mission) -> str | None:
    """Return a digest of everything that a plan and its certificate depend on.

    None where the sources have changed since this process started.
    """
    program = checks()
    if program is None:
        return None
    document = json.dumps(mission.model_dump(mode="json"), sort_keys=True)
    everything = f"{program} {jit.compiler()} {scipy.__version__}\n{document}"
    return hashlib.sha256(everything.encode()).hexdigest()


def _prune(folder: Path) -> None:
    """Remove what is older than KEPT, and the oldest entries beyond MOST_BYTES."""
    entries = []
    for path in folder.iterdir():
        with suppress(OSError):  # another process may have removed it
            status = path.stat()
            entries.append((status.st_mtime, status.st_size, path))
    total = 0
    for written, size, path in sorted(entries, reverse=True):
        total += size
        if time.time() - written > KEPT or total > MOST_BYTES:
            with suppress(OSError):
                path.unlink()
