"""The pages of many dry runs and of a simulated rope: HTML that needs no network."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from matplotlib.figure import Figure

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.formatting import metres
from swarm.reports.page import Html, key_figures, page, picture, pictures, section, table, tag
from swarm.reports.report_parts import (
    CLEARANCES,
    findings,
    footer,
    kept,
    knot_in_words,
    or_dash,
    plan_figures,
)

TRIAL_DISTANCES: Final = {**CLEARANCES, "hung": "cable to cable, as the emulator's cable hung"}


def trials_report(
    plan: Plan,
    assessment: Assessment,
    told: Sequence[Mapping[str, Any]],
    figures: Sequence[Figure],
) -> str:
    """Return the page of many dry runs: what they say, pictures, worst trials, and the plan.

    ``told`` are the JSON objects that ``swarm dry-run --trials --json`` prints, of this plan first,
    ``figures`` are what is drawn of them.
    """
    first = told[0]
    sound, below = first["no_vehicle_failing"], first["certificate"]["below"]
    good = sound["completed"]["count"] == sound["trials"] and not below
    words = (
        f"{sound['completed']['count']} of {sound['trials']} trials without a failing vehicle "
        f"were completed as planned; {len(below)} of {first['certificate']['compared']} came "
        "closer than was certified for their tracking error."
    )
    return page(
        f"Trials: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: {first['trials']} dry runs"),
        tag("p", f"Seed {first['seed']}; virtual time, emulated vehicles and cable", kind="dim"),
        tag("div", words, kind="verdict good" if good else "verdict bad"),
        key_figures(_trial_figures(first)),
        section(
            "Pictures",
            pictures(*(picture(one, "Smallest distances of all trials") for one in figures)),
        ),
        *(section(_whose(one), _distances_table(one), _reasons(one)) for one in told),
        section("Worth a look", _worst_trials(first)),
        section("What was drawn", _drawn(first["spread"])),
        section("The plan", key_figures(plan_figures(plan, assessment)), findings(assessment)),
        footer(),
    )


def rope_report(
    plan: Plan, assessment: Assessment, told: Sequence[Mapping[str, Any]], figure: Figure
) -> str:
    """Return the page of a simulated rope.

    ``told`` are the JSON objects that ``swarm dry-run --rope --json`` prints, this plan's first.
    """
    first = told[0]
    implied = knot_in_words(first["knot"]["type"], first["knot"]["chirality"])
    good = first["knot"]["as_planned"] and not first["void"]
    words = (
        f"This run shows nothing: {'; '.join(first['void'])}."
        if first["void"]
        else f"The rope ends in {implied}{'' if good else ', which is not what was planned'}."
    )
    return page(
        f"Rope: {plan.mission.name}",
        tag("h1", f"{plan.mission.name}: a rope of {first['links']} links"),
        tag("p", f"Asked for {knot_in_words(plan.knot.type, plan.knot.chirality)}", kind="dim"),
        tag("div", words, kind="verdict good" if good else "verdict bad"),
        section("Pictures", pictures(picture(figure, "The rope's motion and end", wide=True))),
        section("Figures", _rope_table(told)),
        section("The plan", key_figures(plan_figures(plan, assessment)), findings(assessment)),
        footer(),
    )


def _rope_table(told: Sequence[Mapping[str, Any]]) -> Html:
    def depth(one: Mapping[str, Any]) -> str:
        return (
            f"{one['penetration']['radii']:.2f} radii (void beyond {one['penetration']['most']:g})"
        )

    rows = [
        ("knot", *(knot_in_words(one["knot"]["type"], one["knot"]["chirality"]) for one in told)),
        ("shows something", *("no" if one["void"] else "yes" for one in told)),
        ("closest strands", *(or_dash(one["smallest_distance"], "m") for one in told)),
        (
            "those of the quasi-static cable",
            *(or_dash(one["smallest_distance_of_quasi_static_cable"], "m") for one in told),
        ),
        ("deepest penetration", *map(depth, told)),
        ("largest stretch", *(f"{one['stretch']['share']:.2%}" for one in told)),
        ("top speed", *(f"{one['speed']['metres_per_second']:.1f} m/s" for one in told)),
        (
            "farthest from the quasi-static cable",
            *(metres(one["stray"]["largest"]) for one in told),
        ),
        (
            "there and then by sway and a stop, in the budget's models",
            *(metres(one["stray"]["sway_and_stop"]) for one in told),
        ),
        ("farther than these by", *(metres(one["stray"]["farther"]["by"]) for one in told)),
        ("simulated, took", *(f"{one['simulated']:.0f} s, {one['took']:.0f} s" for one in told)),
    ]
    return table(("", *(one["trajectory"] for one in told)), rows)


def _whose(told: Mapping[str, Any]) -> str:
    return "The paper's trajectory" if told["method"] == "paper" else "This plan"


def _trial_figures(told: Mapping[str, Any]) -> list[tuple[str, object]]:
    sound = told["no_vehicle_failing"]
    low, high = sound["completed"]["interval"] or (0.0, 1.0)
    return [
        ("trials", told["trials"]),
        ("of them with a failing vehicle", told["one_vehicle_failing"]["trials"]),
        (f"completed, {told['confidence']:.0%} interval", f"{low:.1%} to {high:.1%}"),
        ("with a rotor on cable", told["trials_with_strikes"]),
        ("with vehicles touching", told["trials_with_collisions"]),
        ("vehicles lost", told["vehicles_lost"]),
    ]


def _distances_table(told: Mapping[str, Any]) -> Html:
    rows = []
    for kind, values in told["no_vehicle_failing"]["clearance"].items():
        if values["count"]:
            cells = [kept(values["smallest"], values["required"])]
            for share in ("0.05", "0.5"):
                quantile = values["quantiles"][share]
                low, high = (f"{v:.2f}" if v is not None else "?" for v in quantile["interval"])
                between = tag("span", f"[{low}, {high}]", kind="range")
                cells.append(Html(f"{metres(quantile['value'])} {between}"))
            rows.append((TRIAL_DISTANCES[kind], *cells, metres(values["required"])))
    head = ("no vehicle failing", "smallest", "5 %", "median", "required")
    return table(head, rows, frozenset({1, 2, 3, 4}))


def _reasons(told: Mapping[str, Any]) -> Html:
    rows = [(reason, count) for reason, count in told["reasons"].items()]
    return table(("not completed, because of", "trials"), rows, frozenset({1}))


def _worst_trials(told: Mapping[str, Any]) -> Html:
    rows = [
        (
            one["trial"],
            "unknown" if one["cable"] is None else metres(one["cable"]),
            one["outcome"],
            one["failing"] or "–",
            one["reason"] or "–",
        )
        for one in told["worst"]
    ]
    head = ("trial", "cable to cable", "outcome", "what was made to fail", "reason")
    return table(head, rows, frozenset({0, 1}))


def _drawn(spread: Mapping[str, Any]) -> Html:
    rows = [
        (name, ", ".join(value) if isinstance(value, list) else f"{value:g}")
        for name, value in spread.items()
    ]
    return table(("key of the scenario's spread", "value"), rows)
