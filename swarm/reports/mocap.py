"""The poses of a fleet: a row for each vehicle, for terminal and JSON; seconds and metres."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from swarm.flight.bodies import PoseRow
from swarm.ground.mocap_bridge import BridgeState
from swarm.reports.result import SEVERITIES, Cell, Table


def poses_table(rows: Sequence[PoseRow]) -> Table:
    """Return a table with the poses of each vehicle."""
    lines = [
        (
            str(row.system),
            f"{row.rate:.0f}",
            "never" if row.age is None else f"{row.age:.2f}",
            "" if row.distance is None else f"{row.distance:.2f}",
            Cell(row.problem, SEVERITIES[row.severity]),
        )
        for row in rows
    ]
    return Table(("system", "poses/s", "age s", "off m", ""), lines, numbers=(0, 1, 2, 3))


def poses_object(rows: Sequence[PoseRow]) -> list[dict[str, Any]]:
    """Return the poses of each vehicle: rate in Hz, age in seconds, distance in metres."""
    return [asdict(row) for row in rows]


def bridge_words(state: BridgeState) -> str:
    """Return the line below the table: who uses the links, and what is armed."""
    words = "no ground station uses the links"
    if state.borrower is not None:
        words = f"the ground station in process {state.borrower} uses the links"
    if state.armed:
        words += f"; armed: {', '.join(map(str, state.armed))}"
    if state.strangers:
        words += f"; bodies of no vehicle: {', '.join(map(str, state.strangers))}"
    return words


def bridge_object(state: BridgeState) -> dict[str, Any]:
    """Return the state of a bridge."""
    return {
        "vehicles": poses_object(state.rows),
        "other_bodies": list(state.strangers),
        "armed": list(state.armed),
        "ground_station": state.borrower,
    }
