import io
import json
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jinja2 import UndefinedError
from matplotlib.figure import Figure
from rich.console import Console

from swarm.certification.budget import Budget
from swarm.certification.clearances import Moment
from swarm.certification.findings import Finding
from swarm.flight.snapshot import Event
from swarm.flight.trace import Trace
from swarm.mission.fleet import emulated_fleet
from swarm.planning import digest
from swarm.reports.failures import failures_report
from swarm.reports.flight import flight_report
from swarm.reports.layout_sheet import layout_sheet
from swarm.reports.pages import render
from swarm.reports.plan import certificate_report, plan_report, print_plan_summary
from swarm.reports.rope import rope_report
from swarm.reports.trials import trials_report
from tests.reports.synthetic import events, trefoil_plan
from tests.reports.test_terminal import assessment

PLAN = trefoil_plan()
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
VOID = {"meta", "img", "input"}


class Reader(HTMLParser):
    """Collects text and addresses, and asserts that every element is closed."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.words = ""
        self.addresses: list[str] = []
        self.images = 0
        self.open: list[str] = []
        self.feed(source)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.images += tag == "img"
        self.addresses += [value or "" for key, value in attrs if key in {"src", "href"}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data + " "


def trace() -> Trace:
    times = np.linspace(0.0, PLAN.duration, 300)
    setpoint = PLAN.motion.at(times)[0]
    position = setpoint + 0.02
    position[:5, 2] = np.nan
    phase = tuple(PLAN.phase_at(float(time)).name for time in times)
    return Trace(times + 3.0, times, position, setpoint, phase)


def outcome(**changed: Any) -> dict[str, Any]:
    kept = {"distance": 0.3, "required": 0.15, "time": 51.0, "between": ["segment 3", "segment 5"]}
    return {
        "outcome": "done",
        "explanation": "all vehicles have landed",
        "knot": {"type": "3_1", "chirality": "right", "gauss": "", "as_planned": True},
        "clearance": {
            "cable": {"flown": kept, "certified": kept},
            "vehicle": {"flown": None, "certified": kept},
            "vehicle_cable": {"flown": kept, "certified": kept},
        },
        "certificate": {
            "description": "certified for tracking errors of up to 0.1 m; carrying cable"
        },
        "adherence": {"within": True, "words": ""},
        "max_chord_ratio": 0.94,
        "tracking_error": [
            {"phase": "fold", "vehicle": v, "rms": 0.03, "p999": 0.1, "max": 0.17} for v in (0, 1)
        ],
        "duration": 92.0,
        "setpoints": 1000,
        "setpoint_gap": {"seconds": 0.05, "at": 0.0},
        "setpoint_lateness": None,
        "packets_lost": {"1": 2},
        "notes": ["segment 3 was reported 101 % of its length apart"],
        **changed,
    }


@pytest.mark.slow
def test_the_plan_report_has_verdict_and_findings() -> None:
    remark = Finding("info", "scope", "from <contract> to hold")
    refused = assessment(remark, Finding("error", "taut", "segment 2 is over-stretched", 51.3))
    read = Reader(plan_report(PLAN, refused))
    assert "Refused: 1 error (taut)." in read.words
    assert "from <contract> to hold" in read.words
    assert read.words.index("over-stretched") < read.words.index("<contract>")
    assert read.images == 5
    words = Reader(cleared_plan_report()).words
    assert "Cleared: 3_1, right-handed, tracking errors up to 0.10 m. Not certified:" in words
    assert "Certified in the quasi-static cable model. Not certified: swing, gusts, rotor" in words


@pytest.mark.slow
def test_the_plan_report_has_pictures_above_findings_and_tables_of_moments_and_budget() -> None:
    warning = Finding("warning", "swing", "swings")
    tight = Finding("info", "tightest", "1. vehicle clearance: as a sentence")
    at = (0.0, 0.0, 4.0)
    moments = (
        Moment("neighbouring segments", ("segment 6", "segment 7"), 0.28, 0.15, 52.7, at),
        Moment("cable clearance", ("segment 2", "segment 7"), 0.32, 0.15, 70.0, at),
        Moment("vehicle clearance", ("vehicle 1", "vehicle 7"), 1.09, 1.0, 68.8, at),
    )
    row = Budget(("segment 6", "segment 7"), 52.7, 0.4, 0.2, 0, 0, 0.02, 0.01, 0.16, 0, 0, 0.15)
    found = replace(assessment(warning, tight), moments=moments, budget=(row,))
    source = plan_report(PLAN, found)
    heads = ["Pictures", "Smallest distances", "Findings", "Tightest moments", "Clearance budget"]
    places = [source.index(f"<h2>{head}</h2>") for head in heads]
    assert places == sorted(places)
    assert source.index('class="verdict warn"') < places[0]
    read = " ".join(Reader(source).words.split())
    assert "as a sentence" not in read
    assert "vehicle clearance 1.09 m 1.00 m +0.09 m 68.8 s vehicle 1 and vehicle 7" in read
    assert "segments 6 and 7 at 52.7 s 40 20 0 0 2 1 16 0 0 15 -14" in read
    assert (
        "Beyond the exempt length they keep 0.28 m of 0.15 m: segment 6 and segment 7 at 52.7 s."
        in read
    )


@pytest.mark.slow
def test_reports_load_no_other_file() -> None:
    for source in (cleared_plan_report(), made_flight_report()):
        read = Reader(source)
        assert read.addresses
        assert all(address.startswith("data:image/png;base64,") for address in read.addresses)
        assert "http" not in source
        assert "url(" not in source
        assert "@import" not in source


@cache
def cleared_plan_report() -> str:
    return plan_report(PLAN, assessment())


def made_flight_report(**changed: Any) -> str:
    text = [Event(80.0 + 0.1 * v, "text", "Landing detected", v) for v in (1, 2, 3)]
    happened = [*events(PLAN), *text, Event(81.0, "mode", "mode land", 4)]
    return flight_report(PLAN, assessment(), outcome(**changed), trace(), happened)


def test_the_flight_report_has_the_outcome() -> None:
    read = Reader(made_flight_report())
    assert "Done: all vehicles have landed." in read.words
    assert "positions imply 3_1, right-handed." in read.words
    assert "unknown" in read.words
    assert "segment 3 was reported 101 % of its length apart" in read.words
    assert "vehicles 1–3: Landing detected" in read.words
    assert "mode land" not in read.words
    assert read.images == 5
    assert "Flown certified for tracking errors of up to 0.1 m; carrying cable." in read.words
    assert "outside its certificate" not in read.words


def test_a_flight_outside_its_certificate_is_not_green() -> None:
    words = "flown outside its certificate: vehicle 1 was 0.17 m off"
    source = made_flight_report(adherence={"within": False, "words": words})
    read = Reader(source)
    assert read.words.index("Flown outside its certificate") < read.words.index("Done: all")
    assert 'class="verdict good"' not in source


@pytest.mark.slow
def test_a_failed_flight_is_not_green() -> None:
    source = made_flight_report(outcome="failed", explanation="vehicle 4: no answer")
    assert 'class="verdict bad"' in source
    assert "Failed: vehicle 4: no answer." in Reader(source).words
    other = {"type": "0_1", "chirality": "none", "gauss": "", "as_planned": False}
    source = made_flight_report(knot=other)
    assert 'class="verdict bad"' in source
    assert "positions imply 0_1, not the planned knot." in Reader(source).words


def test_a_flight_without_any_packet_has_a_report() -> None:
    none = np.empty((0, PLAN.vehicles, 3))
    empty = Trace(np.empty(0), np.empty(0), none, none, ())
    ended = outcome(outcome="failed", explanation="vehicle 4: no answer")
    read = Reader(flight_report(PLAN, assessment(), ended, empty, []))
    assert "Failed: vehicle 4: no answer." in read.words
    assert read.images == 3


def test_markup_in_a_mission_name_is_escaped() -> None:
    name = '<img src=x onerror="alert(1)">'
    plan = replace(PLAN, mission=PLAN.mission.model_copy(update={"name": name}))
    source = plan_report(plan, assessment())
    assert "<img src=x" not in source
    assert name in Reader(source).words


def drawn() -> Figure:
    figure = Figure(figsize=(8.0, 4.0))
    figure.subplots().plot([0.0, 1.0])
    return figure


def share(count: int, low: float, high: float) -> dict[str, Any]:
    return {"count": count, "share": 0.5, "interval": [low, high]}


GIVEN = ["m.yaml", "--scenario", "my winds.yaml"]


def made_trials_report(below: tuple[int, ...] = ()) -> str:
    quantile = {"value": 0.5, "interval": [None, 0.55]}
    kept: dict[str, Any] = {"count": 2, "smallest": 0.41, "largest": 0.6, "required": 0.15}
    kept["quantiles"] = {"0.05": quantile, "0.5": quantile, "0.95": quantile}
    worst = {"trial": 7, "cable": None, "outcome": "failed", "reason": "lost", "failure": "<b>"}
    document = {
        "method": "certified", "trials": 3, "seed": 4, "confidence": 0.95,
        "spread": {"wind": 0.5, "failures": ["link", "reboot"]},
        "without_failure": {
            "trials": 2, "completed": share(2, 0.16, 1.0), "clearance": {"cable": kept},
        },
        "with_failure": {"trials": 1, "completed": share(0, 0.0, 0.98), "clearance": {}},
        "trials_with_rotor_strikes": 0, "trials_with_collisions": 0, "vehicles_lost": 0,
        "reasons": {"lost": 1}, "worst": [worst],
        "certificate": {"compared": 3, "below": list(below)},
    }  # fmt: skip
    return trials_report(
        PLAN, assessment(), [document, {**document, "method": "paper"}], [drawn()], GIVEN
    )


def made_rope_report(*void: str) -> str:
    document = {
        "trajectory": "this plan", "computing_time": 20.0, "simulated": 130.0, "links": 400,
        "knot": {"type": "3_1", "chirality": "right", "as_planned": True}, "invalid": list(void),
        "smallest_distance": None, "penetration": {"radii": 0.2, "limit": 1.5},
        "stretch": {"share": 0.004}, "speed": {"metres_per_second": 1.5},
        "smallest_distance_of_quasi_static_cable": 0.61,
        "deviation": {
            "largest": 0.29, "segment": 2, "time": 40.0, "allowed_swing": 0.17,
            "beyond_models": {"share": 0.1, "by": 0.12},
        },
    }  # fmt: skip
    return rope_report(PLAN, assessment(), [document], drawn())


def test_the_trials_report_has_the_statistics() -> None:
    read = Reader(made_trials_report())
    assert "2 of 2 trials without a failure were completed as planned" in read.words
    assert "verdict good" in made_trials_report()
    assert "verdict bad" in made_trials_report(below=(7,))
    assert "<b>" in read.words  # drawn values are text and not markup
    for words in ("The paper's trajectory", "0.41 m", "link, reboot", "16.0% to 100.0%"):
        assert words in read.words


def test_the_report_of_an_invalid_rope_is_not_green() -> None:
    assert "The rope ends in 3_1, right-handed." in Reader(made_rope_report()).words
    void = made_rope_report("a link was stretched by 43.5%, more than 1%")
    assert "verdict bad" in void
    assert "This run is invalid: a link was stretched by 43.5%, more than 1%." in void


def test_a_template_without_one_of_its_values_is_refused() -> None:
    with pytest.raises(UndefinedError, match="'mission' is undefined"):
        render("layout_sheet.html.j2")


def test_the_sheet_says_by_how_much_slack_cable_is_folded_back() -> None:
    mission = PLAN.mission.model_copy(update={"lay": "slack"})
    more = np.where(np.arange(8) == 0, 2.2, 1.4) * PLAN.layout.lengths  # of taut segments
    slack = replace(PLAN, mission=mission, layout=replace(PLAN.layout, lengths=more))
    words = " ".join(Reader(layout_sheet(slack)).words.split())
    assert "next segment folded back by" in words
    assert "6.69 m 0.96 m" in words
    assert "10.52 m 2 × 1.43 m" in words
    assert "fold each segment back on itself in its middle, along the line" in words
    assert "folded back" not in Reader(layout_sheet(PLAN)).words


def made_failures_report() -> str:
    document: dict[str, Any] = {
        "case": "gripper slips", "group": "one vehicle", "autopilots": "px4", "times": [60.0],
        "detected_after": 0.95, "response": "grip slip, landing together", "strand_distance": None,
        "vehicle_distance": 3.1, "chord_ratio": None, "rotor_strikes": 0, "vehicles_lost": 0, "end": "landed",
        "passed": True, "problems": [], "explanation": "one long strand from then on",
    }  # fmt: skip
    failed = {**document, "autopilots": "mixed", "passed": False, "problems": ["at 60.0 s: <late>"]}
    return failures_report(PLAN, [document, failed])


def test_the_page_of_failure_tests_shows_every_case_and_the_tests_of_system_cases() -> None:
    source = made_failures_report()
    assert "1 of 2 failure tests failed (2 flights): gripper slips (mixed)." in source
    assert "at 60.0 s: &lt;late&gt;" in source
    assert source.count("gripper slips") == 2  # in the banner and in one row
    assert "test_a_stalled_sink_delays_neither_flight_nor_other_sinks" in source


LOOK = """<!doctype html><title>-</title><iframe style="width:%dpx; height:900px; border:0"
srcdoc="%s"></iframe><script>addEventListener("load", () => {
  const page = document.querySelector("iframe").contentDocument;
  const wide = page.documentElement.clientWidth;
  const out = (e) => !e.closest(".scroll, pre") && e.getBoundingClientRect().right > wide + 1;
  document.title = JSON.stringify({
    sideways: page.documentElement.scrollWidth - wide,
    broken: [...page.images].filter((i) => !(i.complete && i.naturalWidth)).length,
    outside: [...page.body.querySelectorAll("*")].filter(out).length,
    cut: [...page.querySelectorAll(".scroll")].filter(
      (e) => e.scrollWidth > e.clientWidth + 1).length }) })</script>"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs a Chromium to look with")
@pytest.mark.parametrize("width", [360, pytest.param(1000, marks=pytest.mark.full)])
def test_a_browser_shows_every_report_without_sideways_scrolling(
    width: int, tmp_path: Path
) -> None:
    for name, source in (
        ("plan", cleared_plan_report()),
        ("flight", made_flight_report()),
        ("trials", made_trials_report()),
        ("sheet", layout_sheet(PLAN, emulated_fleet(PLAN.vehicles), (), assessment())),
        ("certificate", certificate_report("motion.csv", assessment(), 0.1)),
        ("rope", made_rope_report()),
        ("failures", made_failures_report()),
    ):
        file = tmp_path / f"{name}.html"
        file.write_text(LOOK % (width, escape(source)), encoding="utf-8")
        seen = subprocess.run(
            [
                str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
                f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=5000",
                file.as_uri(),
            ],
            check=True, capture_output=True, text=True, timeout=60,
        ).stdout  # fmt: skip
        found = json.loads(seen.split("<title>")[1].split("</title>")[0])
        cut = found.pop("cut")
        assert cut == 0 or name not in {"plan", "sheet"}, f"{cut} tables of a {name} are cut off"
        assert found == {"sideways": 0, "broken": 0, "outside": 0}


def test_the_trials_page_has_units_and_a_command_to_paste() -> None:
    words = " ".join(Reader(made_trials_report()).words.split())
    assert "wind 0.5 m/s" in words
    command = "swarm dry-run m.yaml --scenario 'my winds.yaml' --seed 4 --trial 7"
    assert f"To repeat the worst: {command} --recording trial.rrd" in words


@pytest.mark.slow
def test_one_value_is_rounded_down_in_one_way() -> None:
    """A plan's page, its terminal text and its sheet state the same e*, w* and distances."""
    found = assessment()
    known = replace(found, robustness=replace(found.robustness, wind=2.669, tracking=0.1296))
    close = replace(known.distances["vehicle"], distance=1.0697)
    known = replace(known, distances={**known.distances, "vehicle": close})
    console = Console(file=io.StringIO(), width=120)
    print_plan_summary(PLAN, known, console)
    for source in (
        console.file.getvalue(),
        Reader(plan_report(PLAN, known)).words,
        Reader(layout_sheet(PLAN, assessment=known)).words,
    ):
        assert "2.6 m/s" in source
        assert "0.12 m" in source
        for wrong in ("2.66", "2.67", "2.7 m/s", " 0.13 m", "1.07"):
            assert wrong not in source
    assert "1.06 m" in console.file.getvalue()
    assert "1.06 m" in plan_report(PLAN, known)


def test_the_sheet_names_its_plan() -> None:
    assert f"Plan SHA-256 {digest(PLAN)}" in Reader(layout_sheet(PLAN)).words


def test_a_certificate_has_a_page() -> None:
    refused = assessment(Finding("error", "taut", "segment 2 is over-stretched", 51.3))
    read = Reader(certificate_report("motion.csv", refused, 0.1))
    assert "motion.csv: certificate" in read.words
    assert "Refused: 1 error (taut)." in read.words
    assert "segment 2 is over-stretched" in read.words
