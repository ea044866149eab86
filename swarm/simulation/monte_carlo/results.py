"""Trials as a table: one row per trial, with what made them in its metadata."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from swarm.errors import InputError, Problem, reason
from swarm.planning import Plan
from swarm.simulation.monte_carlo.spread import Spread
from swarm.simulation.monte_carlo.trial import Trial, rows
from swarm.version import __version__


def results_table(done: Sequence[tuple[Plan, Sequence[Trial]]], seed: int, spread: Spread) -> Any:
    """Return trials of plans as a :class:`pyarrow.Table`, the columns of :class:`Trial` and more.

    ``method`` and ``seed`` come first. Version, mission and spread are in the table's metadata.
    """
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    table = pa.Table.from_pylist(
        [
            {"method": plan.mission.fold.method, "seed": seed, **row}
            for plan, flown in done
            for row in rows(flown)
        ]
    )
    made_by = {
        "swarm": __version__,
        "mission": json.dumps(done[0][0].mission.document()),
        "spread": json.dumps(spread.model_dump(mode="json")),
    }
    return table.replace_schema_metadata(made_by)


def write_results(
    path: Path, done: Sequence[tuple[Plan, Sequence[Trial]]], seed: int, spread: Spread
) -> None:
    """Write :func:`results_table` as Parquet; raises :class:`InputError` where that fails."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    try:
        pq.write_table(results_table(done, seed, spread), path)
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None
