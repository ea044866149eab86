"""One sentence that states a result first, at the level of the worst row that follows it.

Terminal and pages show the same verdict.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from swarm.certification.assessment import Assessment
from swarm.certification.budget import least_remaining
from swarm.certification.findings import Finding
from swarm.planning import Plan
from swarm.reports.formatting import metres
from swarm.reports.wording import CERTIFIED, TRIAL_DISTANCES, implied_in_words, knot_in_words

Level = Literal["good", "warn", "bad"]
FailureTestDocument = Mapping[str, Any]
"""The JSON object of a failure test."""

_NAMED: Final = 3
"""Failed tests that a verdict names; more would not fit into a line or two."""


@dataclass(frozen=True)
class Verdict:
    """A result in words, the level of its worst row, and what the words leave out."""

    level: Level
    words: str
    details: str = ""


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
    closer = _closer_than_required(assessment)
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


def _closer_than_required(assessment: Assessment) -> str:
    """Return by how much a distance is short if all effects come together; "" where none is."""
    remaining = least_remaining(assessment.budget)
    return metres(-remaining) if remaining < 0.0 else ""


def findings_verdict(findings: Sequence[Finding], certified: str = CERTIFIED) -> Verdict:
    """Return the verdict on findings that belong to no plan."""
    if any(finding.severity == "error" for finding in findings):
        return Verdict("bad", _refused(findings))
    level, head = _cleared(findings)
    return Verdict(level, f"{head}: {certified}.")


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


def flight_verdict(plan: Plan, outcome: Mapping[str, Any]) -> Verdict:
    """Return how a flight ended, the implied knot, and every way in which it missed its plan.

    ``outcome`` is the JSON object of the flight.
    """
    adherence = outcome["adherence"]
    problems = _too_close(outcome["clearance"])
    as_planned = outcome["outcome"] == "done" and outcome["knot"]["as_planned"]
    sentences = [f"{outcome['outcome']}: {outcome['explanation']}"]
    sentences += [implied_in_words(plan, outcome["knot"]).removesuffix("."), *problems]
    if not adherence["within"]:
        sentences.insert(0, adherence["words"])
    level: Level = "good" if as_planned and adherence["within"] and not problems else "bad"
    tracking = plan.mission.vehicles.tracking
    largest = largest_fold_error(outcome)
    if adherence["within"] and largest is not None and largest > tracking > 0:
        sentences.append(
            f"the tracking error in the fold reached {largest:.3f} m, more than {tracking:g} m"
        )
        level = "warn" if level == "good" else level
    return Verdict(level, " ".join(f"{_upper_first(one)}." for one in sentences if one))


def largest_fold_error(outcome: Mapping[str, Any]) -> float | None:
    """Return the largest tracking error in the fold, metres; None where the fold was not flown."""
    errors = [one["max"] for one in outcome["tracking_error"] if one["phase"] == "fold"]
    return max(errors, default=None)


def _too_close(clearance: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each flown distance that is smaller than the required one."""
    return [
        _came_to(name, both["flown"]["distance"], both["certified"]["required"])
        for name, both in clearance.items()
        if both["flown"] and both["flown"]["distance"] < both["certified"]["required"]
    ]


def _came_to(name: str, distance: float, required: float) -> str:
    kind = TRIAL_DISTANCES[name]
    return f"{kind} came to {distance:.2f} m, {required:.2f} m are required"


def trials_verdict(summary: Mapping[str, Any]) -> Verdict:
    """Return how many trials were completed and kept the certificate, and the worst of the rest.

    ``summary`` is the JSON object of the trials.
    """
    intact, certificate = summary["without_failure"], summary["certificate"]
    count, trials = intact["completed"]["count"], intact["trials"]
    below = len(certificate["below"])
    words = (
        f"{count} of {trials} trials without a failure were completed as planned; {below} "
        f"of {certificate['compared']} came closer than certified for their tracking error."
    )
    struck, collided = summary["trials_with_rotor_strikes"], summary["trials_with_collisions"]
    losses = [
        f"{counted(struck, 'trial')} with rotor strikes" if struck else "",
        f"{counted(collided, 'trial')} with collisions" if collided else "",
        f"{counted(summary['vehicles_lost'], 'vehicle')} lost" if summary["vehicles_lost"] else "",
    ]
    close = [
        _came_to(name, one["smallest"], one["required"])
        for name, one in intact["clearance"].items()
        if one["count"] and one["smallest"] < one["required"]
    ]
    worst = [one for one in (*close, *losses) if one]
    if worst:
        words += f" Worst: {'; '.join(worst)}."
    if count < trials or below:
        return Verdict("bad", words)
    return Verdict("warn" if worst else "good", words)


def failures_verdict(tests: Sequence[FailureTestDocument]) -> Verdict:
    """Return how many failure tests passed, which failed, and strikes and losses in any of them."""
    failed = [test for test in tests if not test["passed"]]
    flights = sum(len(test["times"]) for test in tests)
    words = f"All {len(tests)} failure tests passed ({flights} flights)."
    if failed:
        words = f"{len(failed)} of {len(tests)} failure tests failed ({flights} flights): "
        names = dict.fromkeys(f"{test['case']} ({test['autopilots']})" for test in failed)
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        words += ", ".join(list(names)[:_NAMED]) + f"{more}."
    strikes = [test for test in tests if test["rotor_strikes"]]
    lost = max((test["vehicles_lost"] for test in tests), default=0)
    if strikes:
        total = sum(test["rotor_strikes"] for test in strikes)
        worst = max(strikes, key=lambda test: test["rotor_strikes"])
        words += (
            f" {counted(total, 'rotor strike')} on cable, most in: {worst['case']} "
            f"({worst['autopilots']})."
        )
    if lost:
        words += f" At most {counted(lost, 'vehicle')} lost in one flight."
    return Verdict("bad" if failed else "warn" if strikes or lost else "good", words)


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural where it is not one."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _upper_first(text: str) -> str:
    return text[:1].upper() + text[1:]
