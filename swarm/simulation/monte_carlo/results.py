"""Trials as a table: one row per trial; version, mission and spread in the metadata."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from swarm.errors import InputError, Problem, reason
from swarm.planning import Plan
from swarm.simulation.monte_carlo.spread import Spread
from swarm.simulation.monte_carlo.trial import Trial, table_rows
from swarm.version import __version__


def results_table(flown: Sequence[tuple[Plan, Sequence[Trial]]], seed: int, spread: Spread) -> Any:
    """Return the trials of plans as a :class:`pyarrow.Table`.

    The columns are ``method``, ``seed`` and the fields of :class:`Trial`.
    """
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    table = pa.Table.from_pylist(
        [
            {"method": plan.mission.fold.method, "seed": seed, **row}
            for plan, trials in flown
            for row in table_rows(trials)
        ]
    )
    metadata = {
        "swarm": __version__,
        "mission": json.dumps(flown[0][0].mission.document()),
        "spread": json.dumps(spread.model_dump(mode="json")),
    }
    return table.replace_schema_metadata(metadata)


def write_results(
    path: Path, flown: Sequence[tuple[Plan, Sequence[Trial]]], seed: int, spread: Spread
) -> None:
    """Write :func:`results_table` as Parquet; raise :class:`InputError` where that fails."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    try:
        pq.write_table(results_table(flown, seed, spread), path)
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None
