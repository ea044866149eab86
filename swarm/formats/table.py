"""Samples as a Parquet table: one row per moment, one column per figure of a vehicle."""

import json
from pathlib import Path
from typing import Any

from swarm.files import replaced
from swarm.formats.samples import Samples
from swarm.version import __version__


def samples_table(samples: Samples) -> Any:
    """Return samples as a :class:`pyarrow.Table`.

    Columns are ``time``, ``mission_time``, ``phase``, and, for vehicles 1…n,
    ``vehicle_1/position/x`` and so on: ENU, SI; null where unknown. The mission and the version are
    in the metadata, and so is the time 0 in seconds since 1970.
    """
    import pyarrow as pa  # noqa: PLC0415 - slow to import

    columns: dict[str, Any] = {
        "time": pa.array(samples.time),
        "mission_time": pa.array(samples.mission_time),
        "phase": pa.array(samples.phase, pa.string()),
    }
    for k in range(samples.vehicles):
        for name, vector in samples.vectors.items():
            for axis, letter in enumerate("xyz"):
                column = pa.array(vector[:, k, axis], from_pandas=True)  # NaN becomes null
                columns[f"vehicle_{k + 1}/{name}/{letter}"] = column
        for name, scalar in samples.scalars.items():
            columns[f"vehicle_{k + 1}/{name}"] = pa.array(scalar[:, k], from_pandas=True)
    metadata = {
        "swarm": __version__,
        "mission": json.dumps(samples.mission.document()),
        "started": repr(samples.started),
    }
    return pa.table(columns).replace_schema_metadata(metadata)


def write_table(samples: Samples, path: Path) -> None:
    """Write :func:`samples_table` as Parquet; raise :class:`InputError` where that fails."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - slow to import

    with replaced(path) as new:
        pq.write_table(samples_table(samples), new)
