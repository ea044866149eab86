"""The page about drills: everything that can go wrong, what the team did, and how near it came."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from swarm.planning import Plan
from swarm.reports.page import Html, key_figures, page, section, table, tag
from swarm.simulation.fault_injection import SystemFailureCase
from swarm.version import __version__

_HEAD = (
    "", "What goes wrong", "Autopilots", "Noticed (s)", "What the team did", "Strands (m)",
    "Chord", "Strikes", "Lost", "End",
)  # fmt: skip


def failures_report(
    plan: Plan, told: Sequence[Mapping[str, Any]], cited: Sequence[SystemFailureCase] = ()
) -> str:
    """Return the page of the drills of a plan; ``told`` are what ``--failures --json`` prints,
    ``cited`` what is tested elsewhere."""
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
        section(
            "Tested over real sockets, files and processes",
            table(
                ("What goes wrong", "What follows", "Tests"),
                [
                    (
                        one.name,
                        one.follows,
                        tag("div", *(tag("div", test) for test in one.tests), kind="dim small"),
                    )
                    for one in cited
                ],
            ),
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
    before = None
    for one in drills:
        mark = tag("span", "✓", kind="good") if one["passed"] else tag("span", "✗", kind="bad")
        new = one["row"] != before
        before = one["row"]
        name: list[object] = [one["row"]] if new else []
        if new and one["explained"]:
            name.append(tag("div", one["explained"], kind="dim small"))
        ended: list[object] = [one["end"]]
        ended += [tag("div", words, kind="bad") for words in one["problems"]]
        rows.append(
            [
                mark, tag("div", *name), one["personality"], _number(one["detected_after"]),
                one["response"], _number(one["clearance"]), _number(one["chord_ratio"]),
                one["strikes"], one["lost"], tag("div", *ended),
            ]
        )  # fmt: skip
    return table(_HEAD, rows, frozenset({3, 5, 6, 7, 8}))


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
