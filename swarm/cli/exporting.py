"""Files for other programs, chosen by the end of their names; shared by plan and export."""

from collections.abc import Iterable
from pathlib import Path

from swarm.errors import InputError, Problem, SwarmError
from swarm.exports import motion_rows
from swarm.files import write_text
from swarm.formats.samples import Samples, sampled_plan
from swarm.planning import Plan

SAMPLED = (".mcap", ".parquet")
"""Ends of names for samples over time, of a plan or of a flight."""
PLANNED = (".csv", *SAMPLED)
"""Ends of names for the motion of a plan."""


def require_suffix(path: Path, suffixes: Iterable[str]) -> None:
    """Raise :class:`InputError` for a name that does not end in one of the suffixes."""
    *others, last = sorted(suffixes)
    if path.suffix not in {*others, last}:
        message = f"expected a name that ends in {', '.join(others)} or {last}"
        raise InputError([Problem(str(path), message)])


def export_plan(plan: Plan, path: Path) -> None:
    """Write the motion of a plan in the format that the name of the file asks for."""
    require_suffix(path, PLANNED)
    if path.suffix == ".csv":
        write_text(path, "\n".join(motion_rows(plan)) + "\n")
    else:
        export_samples(sampled_plan(plan), path)


def export_samples(samples: Samples, path: Path) -> None:
    """Write samples in the format that the name of the file asks for."""
    require_suffix(path, SAMPLED)
    if path.suffix == ".parquet":
        from swarm.formats.table import write_table  # noqa: PLC0415 - slow to import

        write_table(samples, path)
        return
    try:
        from swarm.formats.mcap_log import write_log  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise SwarmError(
            "MCAP needs more packages: pip install 'swarm-ground-station[mcap]'"
        ) from None
    write_log(samples, path)
