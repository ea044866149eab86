"""The page about drills: everything that can go wrong, what the team did, and how near it came."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from swarm import __version__
from swarm.plans import Plan
from swarm.view.page import Html, key_figures, page, section, table, tag

_HEAD = (
    "", "What goes wrong", "Autopilots", "Noticed (s)", "What the team did", "Strands (m)",
    "Chord", "Strikes", "Lost", "End",
)  # fmt: skip


def failures_report(plan: Plan, told: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of the drills of a plan; ``told`` are what ``--failures --json`` prints."""
    trials = sum(len(one["times"]) for one in told)
    failed = sum(not one["passed"] for one in told)
    words = (
        f"{failed} of {len(told)} drills did not go as asked."
        if failed
        else f"All {len(told)} drills went as asked."
    )
    return page(
        f"Failures: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: when something goes wrong"),
        tag("p", f"{trials} flights in virtual time, judged by what really was", kind="dim"),
        tag("div", words, kind="verdict bad" if failed else "verdict good"),
        key_figures(
            [
                ("drills", len(told)),
                ("flights", trials),
                ("rotor strikes", sum(one["strikes"] for one in told)),
                ("most vehicles lost at once", max((one["lost"] for one in told), default=0)),
            ]
        ),
        *(
            section(str(group).capitalize(), _rows(list(drills)))
            for group, drills in groupby(told, key=lambda one: one["group"])
        ),
        tag(
            "footer",
            f"swarm {__version__}. Each drill starts from the planned flight at random times. "
            "Strands and chords are judged while everybody holds the cable in the air; where the "
            "failure itself moves what was certified, the table says why.",
        ),
    )


def _rows(drills: list[Mapping[str, Any]]) -> Html:
    rows: list[list[object]] = []
    for one in drills:
        mark = tag("span", "✓", kind="good") if one["passed"] else tag("span", "✗", kind="bad")
        explained = f" ({one['explained']})" if one["explained"] else ""
        ended = [*one["problems"]] or [one["end"] + explained]
        rows.append(
            [
                mark, one["row"], one["personality"], _number(one["detected_after"]),
                one["response"], _number(one["clearance"]), _number(one["chord_ratio"]),
                one["strikes"], one["lost"], "; ".join(ended),
            ]
        )  # fmt: skip
    return table(_HEAD, rows, frozenset({3, 5, 6, 7, 8}))


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
