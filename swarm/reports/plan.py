"""A plan and its checks: the verdict, about ten lines of figures, tables; terminal and page."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.table import Table as Grid
from rich.text import Text

from swarm.certification.assessment import Assessment
from swarm.certification.budget import Budget, least_remaining
from swarm.certification.clearances import Moment
from swarm.certification.distances import Tightest
from swarm.certification.findings import Finding
from swarm.certification.kinds import FIGURES, KINDS, MATRIX, coverage, unmeasured
from swarm.knots.catalog import lookup_knot
from swarm.planning import Plan
from swarm.planning.few_vehicles import least_vehicles
from swarm.reports.formatting import (
    certified,
    certified_wind,
    counted,
    knot_in_words,
    metres,
    plan_figures,
    seconds,
    together,
)
from swarm.reports.result import (
    Cell,
    Level,
    Table,
    Verdict,
    compared,
    drawn,
    findings_table,
    indented,
    print_verdict,
    shortened,
)

if TYPE_CHECKING:
    from swarm.reports.pages import Section

IN_TABLES: Final = frozenset({"tightest", "budget"})
"""Checks whose findings are shown as tables."""


def plan_verdict(plan: Plan, assessment: Assessment) -> Verdict:
    """Return what is certified of a plan, for which tracking error, and what is not.

    The words take two lines of 80 columns; the details name the model and everything outside it.
    """
    refused = {finding.check for finding in assessment.findings if finding.severity == "error"}
    if refused - {"budget"}:
        return Verdict("bad", _refused(assessment.findings))
    tracking = plan.mission.vehicles.tracking
    errors = f"tracking errors up to {metres(tracking)}" if tracking > 0 else "exact positions"
    level, head = _cleared(assessment.findings)
    if not len(plan.layout.lengths):
        words = f"{head}: distances between vehicles, {errors}. Not certified: gusts, rotor wash."
        return Verdict(level, words)
    knot = knot_in_words(plan.knot.type, plan.knot.chirality)
    subject = knot if plan.knot.type else "a motion without a knot"
    swinging = assessment.swing_certified
    beside = "other swing" if swinging else "swing"
    remaining = least_remaining(assessment.budget)
    closer = metres(-remaining) if remaining < 0.0 else ""
    short = f" (together {closer} too close)" if closer else ""
    words = (
        f"{head}: {subject}, {errors}. Not certified: {beside}, gusts, rotor wash{short}, friction."
    )
    model = (
        "swinging-cable model (planned motion, one ordinary stop with the resume that follows)"
        if swinging
        else "quasi-static cable model"
    )
    details = (
        f"Certified in the {model}. Not certified: {beside}, gusts, rotor wash, friction, segment "
        f"lengths, and the knot once it is released or on the floor."
    )
    if closer:
        details += f" If all effects come together, strands can be {closer} closer than required."
    if refused:
        words = (
            f"Refused for its budget: {subject} is certified for {errors}, but together with all "
            f"other effects strands are {closer} too close. "
            "limits.accept_negative_budget: true accepts that."
        )
        return Verdict("bad", words, details)
    return Verdict("warn" if closer else level, words, details)


def findings_verdict(findings: Sequence[Finding]) -> Verdict:
    """Return the verdict on findings that belong to no plan."""
    if any(finding.severity == "error" for finding in findings):
        return Verdict("bad", _refused(findings))
    level, head = _cleared(findings)
    return Verdict(level, f"{head}: certified in the quasi-static cable model.")


def _cleared(findings: Iterable[Finding]) -> tuple[Level, str]:
    warnings = sum(finding.severity == "warning" for finding in findings)
    if warnings:
        return "warn", f"Cleared with {counted(warnings, 'warning')}"
    return "good", "Cleared"


def _refused(findings: Iterable[Finding]) -> str:
    """Return the number of errors, and of how many checks each."""
    checks = Counter(finding.check for finding in findings if finding.severity == "error")
    total = sum(checks.values())
    if total == 1 or len(checks) == 1:
        return f"Refused: {counted(total, 'error')} ({next(iter(checks))})."
    each = ", ".join(
        f"{count} {check}" if count > 1 else check for check, count in checks.most_common()
    )
    return f"Refused: {total} errors ({each})."


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print the verdict on findings that belong to no plan, then all of them."""
    print_verdict(findings_verdict(findings), console)
    if findings:
        console.print(indented(drawn(findings_table(findings))))


def print_plan_summary(
    plan: Plan, assessment: Assessment, console: Console, *, verbose: bool = False
) -> None:
    """Print the verdict, the figures, and the warnings and errors: the worst last.

    With ``verbose`` also the tightest moments, the clearance budget, all remarks, and which checks
    compare what, before the warnings.
    """
    print_verdict(plan_verdict(plan, assessment), console, verbose=verbose)
    rows = [*_team_rows(plan, assessment), *_check_rows(plan, assessment)]
    console.print(indented(_grid(rows)))
    if verbose:
        details = _grid(_more_rows(plan, assessment), least=len("vehicle to vehicle"))
        console.print(indented(details, above=0))
        remarks = [finding for finding in _unlisted(assessment) if finding.severity == "info"]
        for table in (
            moments_table(assessment.tightest),
            budget_table(assessment.budget),
            findings_table(remarks),
            coverage_table(),
        ):
            if table.rows:
                console.print(indented(drawn(table)))
        for reason, checks in unmeasured().items():
            words = f"not compared with flights: {', '.join(checks)} ({reason})"
            console.print(Padding(Text(words, "dim"), (0, 0, 0, 2), expand=False))
    problems = [finding for finding in assessment.findings if finding.severity != "info"]
    if problems:
        listed = problems if verbose else shortened(problems)
        console.print(indented(drawn(findings_table(listed))))
    if not verbose:
        words = "All checks, tightest moments and budget: swarm plan with --verbose or --report"
        console.print(Padding(Text(words, "dim"), (1, 0, 0, 0), expand=False))


def _unlisted(assessment: Assessment) -> list[Finding]:
    """Return the findings that no table shows."""
    in_tables = IN_TABLES if assessment.moments else ()
    return [finding for finding in assessment.findings if finding.check not in in_tables]


Rows = list[tuple[str, Text | str]]


def _grid(rows: Rows, least: int | None = None) -> Grid:
    grid = Grid.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True, min_width=least)
    grid.add_column()
    for row in rows:
        grid.add_row(*row)
    return grid


def _team_rows(plan: Plan, assessment: Assessment) -> Rows:
    lengths = plan.layout.lengths
    rows: Rows = [("knot", _knot(plan, assessment))]
    rows.append(("vehicles", f"{plan.vehicles}, {_layout(plan)}"))
    if plan.mission.vehicles.count == "fewest" and plan.layout.cell == 0.0:
        rows += [("", reason) for reason in _why_not_fewer(plan)]
    if len(lengths):
        each = f"{metres(lengths.min())} to {metres(lengths.max())}"
        count = counted(len(lengths), "segment")
        rows.append(("cable", f"{metres(lengths.sum())} in {count} of {each}"))
    folding = plan.phase("fold").duration
    duration = (
        f"{seconds(plan.flight_duration)}: fold {folding:.1f}, "
        f"other {plan.duration - folding:.1f}, gates {plan.expected_waits:.1f}, "
        f"slowing {plan.expected_slowing:.1f}"
    )
    rows.append(("duration", duration))
    return rows


def _why_not_fewer(plan: Plan) -> list[str]:
    """Return what smaller numbers of vehicles lacked, by the notes of a search for the fewest."""
    end = f"folded with {plan.vehicles} vehicles"
    before = plan.notes[1 : plan.notes.index(end)] if end in plan.notes else ()
    return [note for note in before if not note.startswith(("folded", "increased"))]


def _layout(plan: Plan) -> str:
    size = len(plan.knot.grid_columns)
    if not size or plan.mission.layout.corners is not None:
        return "given corners"
    if plan.layout.cell == 0.0:
        bound = least_vehicles(lookup_knot(plan.knot.type).crossings)
        return f"searched layout (lower bound {bound}, grid {2 * size - 1})"
    return f"{size}×{size} grid, cell {metres(plan.layout.cell)}"


def _knot(plan: Plan, assessment: Assessment) -> Text:
    line = Text(knot_in_words(plan.knot.type, plan.knot.chirality))
    planned = plan.knot.type, plan.knot.chirality
    if plan.knot.type and (assessment.knot, assessment.chirality) != planned:
        cable = knot_in_words(assessment.knot, assessment.chirality)
        line.append(f"; the planned cable is {cable}", "bold red")
    return line


def _check_rows(plan: Plan, assessment: Assessment) -> Rows:
    robustness, tracking = assessment.robustness, plan.mission.vehicles.tracking
    done = "certified" if assessment.cleared else "checked"
    error = f"{done} for {metres(tracking) if tracking > 0 else '0 (geometry only)'}"
    if robustness.tracking is not None:
        error += f", holds up to {certified(robustness.tracking)} (e*)"
    rows: Rows = [("tracking error", error)]
    if robustness.wind is not None:
        rows.append(("steady wind", f"holds up to {certified_wind(robustness.wind)} (w*)"))
    if plan.vehicles > 1:
        rows += [
            (name, _distance(tightest))
            for name, tightest in _clearances(assessment)
            if np.isfinite(tightest.distance)
        ]
    if assessment.budget:
        worst = min(assessment.budget, key=lambda row: row.remaining)
        words = f"{certified(worst.remaining)} remain if all effects come together, at "
        style = "yellow" if worst.remaining < 0.0 else ""
        rows.append(("budget", Text(words + seconds(worst.time), style)))
    stops = assessment.contingencies
    if stops is not None:
        words = f"can land together {stops.land.share:.0%} of the time, "
        rows.append(("on a stop", f"{words}release {stops.release.share:.0%}"))
    return rows


def _clearances(assessment: Assessment) -> list[tuple[str, Tightest]]:
    return [(FIGURES[figure], tightest) for figure, tightest in assessment.distances.items()]


def _distance(tightest: Tightest) -> Text:
    """Return a certified distance with the required one, its bodies and its time."""
    enough = tightest.distance >= tightest.required
    text = Text(certified(max(tightest.distance, 0.0)), "green" if enough else "bold red")
    words = f", {metres(tightest.required)} required: {together(tightest.between)} at "
    return text.append(words + seconds(tightest.time), "none")


def _more_rows(plan: Plan, assessment: Assessment) -> Rows:
    rows: Rows = [("Gauss code", plan.knot.gauss)] if plan.knot.type else []
    sags, stops = plan.layout.sags, assessment.contingencies
    if len(sags):
        rows.append(("sags", f"{metres(sags.min())} to {metres(sags.max())}"))
    if stops is not None:
        words = f"{seconds(stops.stop_time)}, {metres(stops.stop_distance)}"
        rows.append(("longest stop", words))
    return rows


def moments_table(moments: Iterable[Moment]) -> Table:
    """Return a table of tight moments."""
    rows = [
        (
            moment.check,
            certified(max(moment.distance, 0.0)),
            metres(moment.required),
            compared(f"{moment.margin:+.2f} m", moment.margin, 0.0),
            seconds(moment.time),
            " and ".join(moment.between),
        )
        for moment in moments
    ]
    columns = ("Tightest", "certified", "required", "margin", "at", "between")
    return Table(columns, rows, numbers=(1, 2, 3, 4))


_BUDGET: Final = (
    ("available", "available"),
    ("tracking", "tracking"),
    ("sag", "amplification"),
    ("length", "length"),
    ("grip", "grip"),
    ("swing", "swing"),
    ("excited", "excited"),
    ("wind", "wind"),
    ("wash", "wash"),
    ("required", "required"),
    ("remaining", "remaining"),
)
"""Columns of the clearance budget: heading and field."""


def budget_table(budget: Iterable[Budget]) -> Table:
    """Return the clearance budget of pairs of strands, in centimetres."""
    rows = [
        (
            f"{together(row.between)} at {seconds(row.time)}",
            *(f"{100.0 * getattr(row, field):.0f}" for _, field in _BUDGET),
        )
        for row in budget
    ]
    columns = ("Budget, cm", *(heading for heading, _ in _BUDGET))
    return Table(columns, rows, numbers=range(1, len(columns)), gap=1)


_SHORT: Final = {
    "tracking errors": "errors",
    "lost setpoints": "lost",
    "live monitor": "monitor",
    "repaired": "repair",
}
"""Headings of the matrix that fit into 80 columns."""


def coverage_table() -> Table:
    """Return the matrix of all certified checks: what counts in them, who else compares them."""
    rows = [
        (kind.check, *("–" if cell.startswith("no") else "yes" for cell in coverage(kind)[1:]))
        for kind in KINDS
    ]
    columns = ("Checks", *(_SHORT.get(name, name) for name in MATRIX[1:]))
    return Table(columns, rows, whole=(0,), gap=1)


def plan_report(plan: Plan, assessment: Assessment) -> str:
    """Return the page of a plan: verdict, figures, pictures, distances, findings, tables."""
    from swarm.reports import pages, scene  # noqa: PLC0415 - slow to import
    from swarm.reports.motion_view import planned_motion  # noqa: PLC0415
    from swarm.reports.plots import plan_pictures  # noqa: PLC0415

    crossings = [
        (f"{crossing.over} over {crossing.under}", f"{crossing.distance:.2f}")
        for crossing in scene.crossings(plan.layout)
    ]
    phases = [
        (phase.name, f"{phase.start:.1f}", f"{phase.end - phase.start:.1f}", phase.cable)
        for phase in plan.phases
    ]
    gates = [(f"{gate.time:.1f}", gate.condition, f"{gate.timeout:.0f}") for gate in plan.gates]
    mission = plan.mission.model_dump_json(by_alias=True, exclude_none=True, indent=1)
    sections = [
        pages.Section("Pictures", pictures=plan_pictures(plan, assessment), least="26rem"),
        *certificate_sections(assessment),
        pages.Section("Segments", [_segments_table(plan)]),
        pages.Section("Crossings", [Table(("segments", "distance, m"), crossings, numbers=(1,))]),
        pages.Section(
            "Phases",
            [Table(("phase", "start, s", "duration, s", "cable"), phases, numbers=(1, 2))],
        ),
        pages.Section(
            "Gates", [Table(("time, s", "until all are", "timeout, s"), gates, numbers=(0, 2))]
        ),
        pages.Section("Notes of the planner", paragraphs=plan.notes),
        pages.Section("Mission", listing=mission),
    ]
    return pages.page(
        "Plan",
        plan.mission.name,
        f"plan for {knot_in_words(plan.knot.type, plan.knot.chirality)}",
        plan_verdict(plan, assessment),
        sections,
        about=[f"Gauss code {plan.knot.gauss}"] if plan.knot.gauss else [],
        figures=plan_figures(plan, assessment),
        motion=planned_motion(plan, assessment),
    )


def certificate_report(name: str, assessment: Assessment, tracking: float) -> str:
    """Return the page of a motion that was planned elsewhere: verdict, distances and findings.

    ``name`` is that of its file, ``tracking`` the tracking error of the certificate in metres.
    """
    from swarm.reports import pages  # noqa: PLC0415 - slow to import

    robustness = assessment.robustness
    return pages.page(
        "Certificate",
        name,
        "certificate",
        findings_verdict(assessment.findings),
        certificate_sections(assessment),
        about=[f"Knot of the cable: {knot_in_words(assessment.knot, assessment.chirality)}"],
        figures=[
            ("tracking error checked", metres(tracking)),
            ("largest tracking error e*", certified(robustness.tracking)),
            ("largest steady wind w*", certified_wind(robustness.wind)),
        ],
    )


def certificate_sections(assessment: Assessment) -> "list[Section]":
    """Return what the checks found: distances, findings, tightest moments and budget."""
    from swarm.reports import pages  # noqa: PLC0415 - slow to import

    return [
        pages.Section(
            "Smallest distances", [_distances_table(assessment)], _neighbours(assessment)
        ),
        pages.Section("Findings", [findings_table(_unlisted(assessment), worst_first=True)]),
        pages.Section("Tightest moments", [moments_table(assessment.tightest)]),
        pages.Section(
            "Clearance budget",
            [budget_table(assessment.budget)],
            "Centimetres. What every effect takes from the distance of the tightest strands if all "
            "come at the same moment. Tracking and sag are certified, the others are estimates.",
        ),
    ]


def _distances_table(assessment: Assessment) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    for name, tightest in _clearances(assessment):
        words, known = certified(tightest.distance), np.isfinite(tightest.distance)
        distance = compared(words, tightest.distance, tightest.required)
        at = (seconds(tightest.time), " and ".join(tightest.between)) if known else ("–", "–")
        rows.append((name, distance, metres(tightest.required), *at))
    return Table(("", "certified", "required", "at", "between"), rows, numbers=(1, 2, 3))


def _neighbours(assessment: Assessment) -> str:
    """Return a sentence on the tightest moment of neighbouring segments; "" without one."""
    check = "neighbouring segments"
    moments = [moment for moment in assessment.moments if moment.check == check]
    if not moments:
        return ""
    tightest = min(moments, key=lambda moment: moment.distance)
    return (
        "Neighbouring segments meet at a vehicle, so they have no curve above. Beyond the exempt "
        f"length they keep {certified(tightest.distance)} of {metres(tightest.required)}: "
        f"{' and '.join(tightest.between)} at {seconds(tightest.time)}."
    )


def _segments_table(plan: Plan) -> Table:
    """Return a row per segment: number, cable, chord, sag and lane, metres."""
    layout = plan.layout
    grips = layout.corners[: len(layout.lengths) + 1]
    chords = np.linalg.norm(np.diff(grips, axis=0), axis=1)
    columns = zip(layout.lengths, chords, layout.sags, layout.lanes, strict=True)
    rows = [
        (str(number), *(f"{value:.2f}" for value in values))
        for number, values in enumerate(columns, 1)
    ]
    headings = ("segment", "cable, m", "chord, m", "sag, m", "lane, m")
    return Table(headings, rows, numbers=range(5))
