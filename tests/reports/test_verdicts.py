import textwrap
from dataclasses import replace
from typing import Any

import pytest

from swarm.certification.assessment import budget_findings
from swarm.certification.budget import Budget
from swarm.certification.findings import Finding
from swarm.reports.failures import failures_verdict
from swarm.reports.flight import flight_verdict, tracking_table
from swarm.reports.plan import findings_verdict, plan_verdict
from swarm.reports.result import Cell
from swarm.reports.trials import trials_verdict
from tests.reports.synthetic import trefoil_plan
from tests.reports.test_report import outcome, share
from tests.reports.test_terminal import assessment

PLAN = trefoil_plan()
WARNING = Finding("warning", "swing", "swings")


def test_a_plan_with_warnings_is_not_green() -> None:
    found = plan_verdict(PLAN, assessment(WARNING, WARNING))
    assert found.level == "warn"
    assert found.words == (
        "Cleared with 2 warnings: 3_1, right-handed, tracking errors up to 0.10 m. "
        "Not certified: swing, gusts, rotor wash, friction."
    )
    assert found.details == (
        "Certified in the quasi-static cable model. Not certified: swing, gusts, rotor wash, "
        "friction, segment lengths, and the knot once it is released or on the floor."
    )
    assert plan_verdict(PLAN, assessment(WARNING)).words.startswith("Cleared with 1 warning: ")


def test_a_plan_for_exact_positions_states_that() -> None:
    vehicles = PLAN.mission.vehicles.model_copy(update={"tracking": 0.0})
    exact = replace(PLAN, mission=PLAN.mission.model_copy(update={"vehicles": vehicles}))
    words = plan_verdict(exact, assessment()).words
    assert words.startswith("Cleared: 3_1, right-handed, exact positions. Not certified")


def test_a_plan_with_limited_swing_is_certified_in_the_swinging_cable_model() -> None:
    quasi_static = plan_verdict(PLAN, assessment())
    assert quasi_static.details.startswith("Certified in the quasi-static cable model. Not")
    found = plan_verdict(PLAN, replace(assessment(), swing_certified=True))
    assert found.words == (
        "Cleared: 3_1, right-handed, tracking errors up to 0.10 m. Not certified: other swing, "
        "gusts, rotor wash, friction."
    )
    assert found.details.startswith(
        "Certified in the swinging-cable model (planned motion, one ordinary stop with the resume "
        "that follows). Not certified: other swing, gusts,"
    )


def test_a_refused_plan_counts_its_errors_by_check() -> None:
    taut = [Finding("error", "taut", f"segment {k}") for k in range(3)]
    found = plan_verdict(PLAN, assessment(*taut, WARNING, Finding("error", "payload", "heavy")))
    assert (found.level, found.words) == ("bad", "Refused: 4 errors (3 taut, payload).")


def test_findings_without_a_plan() -> None:
    assert findings_verdict([]).words == "Cleared: certified in the quasi-static cable model."
    found = findings_verdict([WARNING, Finding("error", "taut", "segment 2")])
    assert (found.level, found.words) == ("bad", "Refused: 1 error (taut).")


IMPLIED = "In the cable model, the reported positions imply 3_1, right-handed."


def errors(largest: float) -> list[dict[str, Any]]:
    return [{"phase": "fold", "vehicle": 1, "rms": 0.03, "p999": largest, "max": largest}]


def near(distance: float) -> dict[str, Any]:
    pair = {"time": 51.0, "between": ["segment 3", "segment 5"], "required": 0.15}
    both = {"flown": {**pair, "distance": distance}, "certified": {**pair, "distance": 0.3}}
    return {"cable": both}


@pytest.mark.parametrize(
    ("changed", "level", "words"),
    [
        ({}, "good", f"Done: all vehicles have landed. {IMPLIED}"),
        (
            {"clearance": near(0.1)},
            "bad",
            f"Done: all vehicles have landed. {IMPLIED} Cable to cable came to 0.10 m, 0.15 m are "
            "required.",
        ),
        (
            {"tracking_error": errors(0.11)},
            "warn",
            f"Done: all vehicles have landed. {IMPLIED} The tracking error in the fold reached "
            "0.110 m, more than 0.1 m.",
        ),
        (
            {"outcome": "failed", "explanation": "vehicle 4: no answer"},
            "bad",
            f"Failed: vehicle 4: no answer. {IMPLIED}",
        ),
        (
            {"adherence": {"within": False, "words": "flown outside its certificate: far off"}},
            "bad",
            f"Flown outside its certificate: far off. Done: all vehicles have landed. {IMPLIED}",
        ),
    ],
)
def test_a_flight_has_the_level_of_its_worst_row(
    changed: dict[str, Any], level: str, words: str
) -> None:
    found = flight_verdict(PLAN, outcome(**{"tracking_error": errors(0.05), **changed}))
    assert (found.level, found.words) == (level, words)


def test_a_cable_that_was_to_have_no_knot_and_has_none_needs_no_sentence() -> None:
    carried = replace(PLAN, knot=replace(PLAN.knot, type="", chirality="none"))
    none = {"type": "0_1", "chirality": "none", "gauss": "", "as_planned": True}
    found = flight_verdict(carried, outcome(knot=none, tracking_error=errors(0.05)))
    assert (found.level, found.words) == ("good", "Done: all vehicles have landed.")
    tied = flight_verdict(carried, outcome(knot={**none, "type": "3_1", "as_planned": False}))
    assert tied.level == "bad"
    assert "imply 3_1, not the planned knot." in tied.words


def trials(below: tuple[int, ...] = (), **changed: Any) -> dict[str, Any]:
    kept = {"count": 2, "smallest": changed.pop("smallest", 0.4), "required": 0.15}
    return {
        "without_failure": {
            "trials": 2, "completed": share(2, 0.1, 1.0), "clearance": {"vehicle_cable": kept},
        },
        "trials_with_rotor_strikes": 0, "trials_with_collisions": 0, "vehicles_lost": 0,
        "certificate": {"compared": 3, "below": list(below)},
        **changed,
    }  # fmt: skip


SOUND = (
    "2 of 2 trials without a failure were completed as planned; {} of 3 came closer than "
    "certified for their tracking error."
)


@pytest.mark.parametrize(
    ("summary", "level", "words"),
    [
        (trials(), "good", SOUND.format(0)),
        (trials(below=(7,)), "bad", SOUND.format(1)),
        (
            trials(smallest=0.1, trials_with_rotor_strikes=1, vehicles_lost=2),
            "warn",
            SOUND.format(0) + " Worst: vehicle to cable came to 0.10 m, 0.15 m are required; 1 "
            "trial with rotor strikes; 2 vehicles lost.",
        ),
    ],
)
def test_trials_have_the_level_of_their_worst_row(
    summary: dict[str, Any], level: str, words: str
) -> None:
    found = trials_verdict(summary)
    assert (found.level, found.words) == (level, words)


def failure_test(**changed: Any) -> dict[str, Any]:
    return {
        "case": "motor stops", "autopilots": "px4", "times": [60.0, 61.0], "rotor_strikes": 0,
        "vehicles_lost": 0, "passed": True, **changed,
    }  # fmt: skip


def test_passed_failure_tests_with_a_rotor_strike_are_not_green() -> None:
    assert failures_verdict([failure_test()]).level == "good"
    found = failures_verdict(
        [failure_test(), failure_test(rotor_strikes=1, vehicles_lost=1, autopilots="mixed")]
    )
    assert (found.level, found.words) == (
        "warn",
        "All 2 failure tests passed (4 flights). 1 rotor strike on cable, most in: motor stops "
        "(mixed). At most 1 vehicle lost in one flight.",
    )


def test_failed_failure_tests_are_named() -> None:
    tests = [failure_test(case=f"case {k}", passed=False) for k in range(5)]
    found = failures_verdict(tests)
    assert (found.level, found.words) == (
        "bad",
        "5 of 5 failure tests failed (10 flights): case 0 (px4), case 1 (px4), case 2 (px4) and 2 "
        "more.",
    )


def test_a_plan_whose_budget_is_short_states_it() -> None:
    row = Budget(
        between=("segment 1", "segment 3"), time=5.0, available=0.5, tracking=0.2,
        amplification=0.05, length=0.01, grip=0.0, swing=0.11, excited=0.09, wind=0.0, wash=0.0,
        required=0.15,
    )  # fmt: skip
    (finding,) = budget_findings([row], accepted=True)
    found = plan_verdict(PLAN, replace(assessment(finding), budget=(row,)))
    assert found.level == "warn"
    assert found.words.endswith(
        " Not certified: swing, gusts, rotor wash (together 0.11 m too close), friction."
    )
    assert found.details.endswith(
        " If all effects come together, strands can be 0.11 m closer than required."
    )
    words = plan_verdict(PLAN, replace(assessment(WARNING, WARNING), budget=(row,))).words
    assert len(textwrap.wrap(words, 80)) == 2
    (finding,) = budget_findings([row], accepted=False)
    found = plan_verdict(PLAN, replace(assessment(finding), budget=(row,)))
    assert (found.level, found.words) == (
        "bad",
        "Refused for its budget: 3_1, right-handed is certified for tracking errors up to 0.10 m, "
        "but together with all other effects strands are 0.11 m too close. "
        "limits.accept_negative_budget: true accepts that.",
    )
    closed = replace(row, available=0.62)
    (finding,) = budget_findings([closed], accepted=False)
    assert finding.message == (
        "+0.01 m remain between segment 1 and segment 3 if all effects come together: 0.62 m at "
        "the setpoints, less tracking 0.20 m, sag and tightening 0.05 m, length tolerance 0.01 m, "
        "leaning droppers 0.00 m, swing 0.11 m, swing by tracking errors 0.09 m, wind 0.00 m, "
        "rotor wash 0.00 m, required 0.15 m"
    )
    found = plan_verdict(PLAN, replace(assessment(finding), budget=(closed,)))
    assert (found.level, "too close" in found.words) == ("good", False)


def test_an_error_is_marked_by_what_is_allowed_in_its_phase():
    """Cable on the floor permits what it does not in the air."""
    plan = trefoil_plan()
    errors = [
        {"phase": phase, "vehicle": 0, "rms": 0.1, "p999": largest, "max": largest}
        for phase, largest in (("takeoff", 0.4), ("grab", 0.6), ("fold", 0.4), ("lift", 0.01))
    ]
    table = tracking_table({"adherence": None, "tracking_error": errors}, plan)
    assert [(row[3], row[4]) for row in table.rows] == [
        ("0.400 m", "0.5 m, no cable in the air"),
        (Cell("0.600 m", "warn"), "0.5 m, no cable in the air"),
        (Cell("0.400 m", "warn"), "0.1 m"),
        ("0.010 m", "0.1 m"),
    ]
