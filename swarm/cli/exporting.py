"""Files for other programs, chosen by the end of their names; shared by plan and export."""

from collections.abc import Iterable
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from swarm.errors import InputError, Problem, SwarmError
from swarm.exports import motion_rows
from swarm.files import write_bytes, write_folder, write_text
from swarm.formats.crazyswarm import MEMORY, trajectory_files
from swarm.formats.skybrush import show_file
from swarm.planner import PlanningResult

if TYPE_CHECKING:
    from swarm.formats.samples import Samples

SAMPLED = (".mcap", ".parquet", ".rosbag")
"""Ends of names for samples over time, of a plan or of a flight."""
FLOWN = (".crazyswarm", ".skyc")
"""Ends of names for programs that fly: cleared plans only."""
PLANNED = (".csv", *FLOWN, *SAMPLED)
"""Ends of names for the motion of a plan."""
_NOT_IN_IT = "without waits at gates, grips, yaw and cable"


def require_suffix(path: Path, suffixes: Iterable[str]) -> None:
    """Raise :class:`InputError` for a name that does not end in one of the suffixes."""
    *others, last = sorted(suffixes)
    if path.suffix not in {*others, last}:
        message = f"expected a name that ends in {', '.join(others)} or {last}"
        raise InputError([Problem(str(path), message)])


def export_plan(planned: PlanningResult, path: Path) -> str:
    """Write the motion of a plan in the format that the name of the file asks for.

    Returns what the user must know of the file, mostly nothing. Raises :class:`Refused` for a
    plan that is not cleared, where the file is for a program that flies.
    """
    require_suffix(path, PLANNED)
    match path.suffix:
        case ".csv":
            write_text(path, "\n".join(motion_rows(planned.plan)) + "\n")
        case ".skyc":
            data, error = show_file(planned.certified())
            write_bytes(path, data)
            return f"at most {ceil(1e4 * error) / 10:.1f} mm from the plan; {_NOT_IN_IT}"
        case ".crazyswarm":
            write_folder(path, trajectory_files(planned.certified()))
            pieces = len(planned.plan.motion.coefficients)
            return f"{_pieces(pieces)}; {_NOT_IN_IT}"
        case _:
            from swarm.formats.samples import sampled_plan  # noqa: PLC0415 - slow to import

            export_samples(sampled_plan(planned.plan), path)
    return ""


def _pieces(count: int) -> str:
    if count <= MEMORY:
        return f"{count} pieces"
    return f"{count} pieces, more than the {MEMORY} that a Crazyflie's memory holds: stream them"


def export_samples(samples: "Samples", path: Path) -> None:
    """Write samples in the format that the name of the file asks for."""
    require_suffix(path, SAMPLED)
    if path.suffix == ".parquet":
        from swarm.formats.table import write_table  # noqa: PLC0415 - slow to import

        write_table(samples, path)
        return
    extra = "mcap" if path.suffix == ".mcap" else "ros"
    try:
        if extra == "mcap":
            from swarm.formats.foxglove import write_log as write  # noqa: PLC0415 - optional
        else:
            from swarm.formats.ros_bag import write_bag as write  # noqa: PLC0415 - optional
    except ImportError:
        message = f"{path.suffix} needs more packages: pip install 'swarm-ground-station[{extra}]'"
        raise SwarmError(message) from None
    write(samples, path)
