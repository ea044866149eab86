import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from swarm.certification.assessment import Assessment, rounded_down
from swarm.certification.clearances import Robustness
from swarm.certification.distances import Tightest
from swarm.certification.findings import Finding
from swarm.flight.requests import REQUESTS
from swarm.flight.snapshot import Event, Snapshot
from swarm.planning import Plan
from swarm.reports.formatting import clock, log_level, metres, seconds, worst_vehicles
from swarm.reports.plan import print_plan_summary
from swarm.reports.terminal import (
    FlightScreen,
    clock_line,
    key_line,
    margin_line,
    phase_line,
    team_table,
    wait_line,
)
from swarm.verification import closest_pairs
from tests.reports.synthetic import snapshot_at, trefoil_plan

PLAN = trefoil_plan()


def assessment(*findings: Finding) -> Assessment:
    return Assessment(
        findings,
        {
            "cable": Tightest(0.21, 0.15, 51.3, ("segment 3", "segment 5")),
            "vehicle": Tightest(1.2, 1.0, 44.0, ("vehicle 5", "vehicle 7")),
            "vehicle_cable": Tightest(np.inf, 0.3, 0.0, ("", "")),
        },
        "3_1",
        "right",
        "1- 2+ 3- 1+ 2- 3+",
        Robustness(tracking=0.14),
    )


def plain(width: int = 100) -> Console:
    return Console(file=io.StringIO(), width=width)


def screen(width: int = 100, height: int = 30) -> Console:
    return Console(file=io.StringIO(), width=width, height=height, force_terminal=True)


def printed(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_summary_of_a_cleared_plan() -> None:
    console = plain()
    print_plan_summary(PLAN, assessment(), console)
    lines = [line.rstrip() for line in printed(console).splitlines()]
    assert lines == [
        "Cleared: 3_1, right-handed, tracking errors up to 0.10 m. Not certified: swing, gusts, "
        "rotor wash, friction.",
        "",
        "  knot                3_1, right-handed",
        "  vehicles            9, 5×5 grid, cell 1.20 m",
        "  cable               33.97 m in 8 segments of 3.00 m to 5.54 m",
        "  duration            99.7 s: fold 36.0, other 53.0, gates 7.2, slowing 3.5",
        "  tracking error      certified for 0.10 m, holds up to 0.14 m (e*)",
        "  cable to cable      0.21 m, 0.15 m required: segments 3 and 5 at 51.3 s",
        "  vehicle to vehicle  1.20 m, 1.00 m required: vehicles 5 and 7 at 44.0 s",
        "",
        "All checks, tightest moments and budget: swarm plan with --verbose or --report",
    ]


def test_summary_never_states_more_than_the_plan_holds_for() -> None:
    console, held = plain(), Robustness(tracking=0.1099, wind=1.87)
    cable = Tightest(0.1595, 0.15, 51.3, ("segment 3", "segment 5"))
    distances = {**assessment().distances, "cable": cable}
    print_plan_summary(PLAN, replace(assessment(), robustness=held, distances=distances), console)
    assert "0.15 m, 0.15 m required: segments 3 and 5" in printed(console)
    assert "certified for 0.10 m, holds up to 0.10 m (e*)" in printed(console)
    assert "holds up to 1.8 m/s (w*)" in printed(console)


@pytest.mark.parametrize(
    ("value", "decimals", "shown"),
    [(0.29, 2, 0.29), (0.3 - 1e-12, 2, 0.29), (0.3, 2, 0.3), (2.0, 1, 2.0), (0.0, 2, 0.0)],
)
def test_values_are_rounded_down_but_not_below_themselves(
    value: float, decimals: int, shown: float
) -> None:
    assert rounded_down(value, decimals) == shown


def test_summary_calls_a_layout_a_grid_only_where_it_is_one() -> None:
    searched = replace(PLAN, layout=replace(PLAN.layout, cell=0.0))
    without_grid = replace(PLAN, knot=replace(PLAN.knot, grid_columns=()))
    for plan, words in (
        (searched, "searched layout (lower bound 5, grid 9)"),
        (without_grid, "given corners"),
    ):
        console = plain()
        print_plan_summary(plan, assessment(), console)
        lines = [line.rstrip() for line in printed(console).splitlines()]
        assert lines[3] == f"  vehicles            9, {words}"


def test_refused_plan_has_the_verdict_first_and_the_errors_last() -> None:
    console = plain()
    remark = Finding("info", "budget", "nothing to add")
    warning = Finding("warning", "swing", "swings by [0.2] m")
    error = Finding("error", "certificate", "segments [3] and [5] touch", 51.3, (0.0, 0.0, 4.0))
    print_plan_summary(PLAN, assessment(error, remark, warning), console, verbose=True)
    lines = [line.rstrip() for line in printed(console).splitlines()]
    assert lines[0] == "Refused: 1 error (certificate)."
    assert lines[-1] == "  error    certificate  segments [3] and [5] touch  51.3 s"
    assert lines[-2] == "  warning  swing        swings by [0.2] m"
    assert [line for line in lines if "nothing to add" in line] == [
        "  info     budget  nothing to add"
    ]
    assert "  Gauss code          1- 2+ 3- 1+ 2- 3+" in lines


def test_many_errors_of_one_check_are_shortened_unless_verbose() -> None:
    errors = [Finding("error", "taut", f"segment {k} is taut", 1.0 * k) for k in range(1, 26)]
    for verbose, count in ((False, 4), (True, 25)):
        console = plain()
        print_plan_summary(PLAN, assessment(*errors), console, verbose=verbose)
        lines = printed(console).splitlines()
        assert lines[0] == "Refused: 25 errors (taut)."
        assert sum(line.startswith("  error ") for line in lines) == count
        assert ("and 22 more errors of this check (--verbose)" in printed(console)) != verbose


def test_another_knot_of_the_planned_cable_is_in_the_figures() -> None:
    console = plain()
    print_plan_summary(PLAN, replace(assessment(), knot="0_1", chirality="none"), console)
    assert printed(console).splitlines()[2].rstrip() == (
        "  knot                3_1, right-handed; the planned cable is 0_1"
    )


def test_no_line_is_wider_than_the_terminal() -> None:
    for width in (60, 80, 120):
        console = Console(
            file=io.StringIO(),
            width=width,
            force_terminal=True,
            color_system=None,
            legacy_windows=False,
        )
        long = Finding("warning", "limits", "a long sentence about something " * 6)
        print_plan_summary(PLAN, assessment(long), console)
        assert max(map(len, printed(console).splitlines())) <= width


def test_flight_in_a_pipe_is_plain_lines() -> None:
    console = plain()
    with FlightScreen(PLAN, console) as shown:
        shown.countdown(3)
        for time in (0.0, 0.05, 6.0, 6.05, 17.0):
            shown.show(snapshot_at(PLAN, time))
        shown.event(Event(17.1, "mode", "mode offboard", 4))
        shown.event(Event(17.2, "warning", "lags [by] 0.2 m", 4))
        shown.event(Event(17.3, "failed", "vehicle 5 dropped out", 5))
    assert printed(console).splitlines() == [
        "-0:03.0 take-off in 3 s",
        "0:00.0 phase takeoff",
        "0:06.0 phase grab",
        "0:17.0 phase contract",
        "0:17.2 vehicle 4: lags [by] 0.2 m",
        "0:17.3 vehicle 5 dropped out",
    ]


def test_a_terminal_that_cannot_move_its_cursor_gets_lines_with_the_keys(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "dumb")
    console = screen()
    moment = snapshot_at(PLAN, 0.0)
    with FlightScreen(PLAN, console, keys=True) as shown:
        for time, open_ in ((0.0, False), (6.0, True), (6.05, True)):
            answers = {
                name: (open_ and name != "resume", "") for name in ("hold", "resume", "land")
            }
            at = replace(moment, time=time, phase="grab" if open_ else "takeoff", available=answers)
            shown.show(at)
    assert printed(console).splitlines() == [
        "0:00.0 phase takeoff",
        "0:06.0 phase grab · h hold · l land",
    ]


def test_what_a_team_on_the_ground_waits_for_is_printed_from_the_beginning() -> None:
    """Also on a terminal, whose screen starts behind the question to the operator."""
    waits = {0.0: "a", 0.1: "b", 1.2: "b", 1.3: "b", 1.4: "c", 3.0: "c"}
    for console in (plain(), screen()):
        shown = FlightScreen(PLAN, console)
        for time, words in waits.items():
            one = replace(snapshot_at(PLAN, 0.0), time=time, phase="prepare", waiting_for=words)
            shown.show(one)
        assert [Text.from_ansi(line).plain for line in printed(console).splitlines()] == [
            "0:00.0 phase prepare: waiting for a",
            "0:01.2 phase prepare: waiting for b",
            "0:03.0 phase prepare: waiting for c",
        ]


def test_flight_on_a_screen_shows_team_and_events() -> None:
    console = screen()
    with FlightScreen(PLAN, console) as shown:
        shown.event(Event(40.0, "gate", "fold begins"))
        shown.show(snapshot_at(PLAN, 50.0))
    text = printed(console)
    assert "clock × 0.40" in text
    assert text.count("OFFBOARD") >= 9
    assert "fold begins" in text
    assert "margin 0.27 m" in text
    assert "^C" not in text  # no keys are read


def lines_of(*texts: Text) -> list[str]:
    return [text.plain for text in texts]


def test_the_lines_of_a_gate() -> None:
    shown = snapshot_at(PLAN, 12.0)
    assert lines_of(clock_line(PLAN, shown), phase_line(PLAN, shown), wait_line(shown)) == [
        "overhand  grab  0:12.0 of 1:29.0  1:17.0 to the end  record 0:12.0",
        "✓ takeoff  grab ━━━━━─── 60%  contract  lift  fold  hold  finish  land",
        "waiting, 24 s left: for all vehicles to grip the cable (gate before contract)",
    ]


def test_the_lines_of_a_hold_and_of_a_rewind() -> None:
    shown = replace(snapshot_at(PLAN, 50.0), rate=-0.5, held="operator command", time_left=55.2)
    assert lines_of(clock_line(PLAN, shown), wait_line(shown)) == [
        "overhand  fold  0:50.0 of 1:29.0  rewinding × 0.50  0:39.0 to the end  record 0:50.0",
        "hold, all land together in 55 s: operator command",
    ]


def test_outside_the_plan_no_phase_is_done() -> None:
    shown = replace(snapshot_at(PLAN, 50.0), phase="contingency", remaining=None)
    assert lines_of(clock_line(PLAN, shown), phase_line(PLAN, shown)) == [
        "overhand  contingency  0:50.0 of 1:29.0  clock × 0.40  record 0:50.0",
        "takeoff  grab  contract  lift  fold  hold  finish  land",
    ]


def test_every_command_has_a_key_beside_it() -> None:
    available = {request: (request != "resume", "") for request in REQUESTS}
    line = key_line(available)
    assert line.plain == (
        "h hold  r resume  b rewind  l land  x release  j rejoin  a abort  k kill  ^C end"
    )
    assert len(line.plain) == 80
    faint = [line.plain[span.start : span.end] for span in line.spans if span.style == "dim"]
    assert [text for text in faint if text != "  "] == ["r", " resume"]
    usual = key_line({**available, "rejoin": (False, "")})
    assert "rejoin" not in usual.plain
    assert len(usual.plain) <= 80


def test_the_screen_of_a_flight_fits_an_80_by_24_terminal() -> None:
    console = screen(80, 24)
    with FlightScreen(PLAN, console, keys=True) as shown:
        for k in range(20):
            shown.event(Event(40.0 + 7 * k, "phase", f"event {k} of a flight with long words " * 4))
        shown.show(replace(snapshot_at(PLAN, 50.0), held="operator command " * 9, time_left=5.0))
        drawn = console.render_lines(shown.drawing(), pad=False)
    assert len(drawn) <= 23
    text = ["".join(part.text for part in line).rstrip() for line in drawn]
    assert max(map(len, text)) <= 80
    assert text[-1].startswith("h hold · r resume · b rewind")
    assert sum("OFFBOARD" in line for line in text) == 9


def test_a_finished_flight_offers_no_keys() -> None:
    console = screen(80, 24)
    with FlightScreen(PLAN, console, keys=True) as shown:
        shown.show(replace(snapshot_at(PLAN, 50.0), phase="finished"))
        drawn = console.render_lines(shown.drawing(), pad=False)
    assert not any("hold" in part.text and "·" in part.text for line in drawn for part in line)


def test_a_screen_without_a_snapshot_says_that_the_flight_starts() -> None:
    console = screen(80, 24)
    with FlightScreen(PLAN, console) as shown:
        first = console.render_lines(shown.drawing(), pad=False)[0]
    assert "".join(part.text for part in first).rstrip() == (
        "starting: links, numerical code, and the emulator if it flies"
    )


def test_the_same_text_of_several_vehicles_is_one_line() -> None:
    console = screen()
    with FlightScreen(PLAN, console) as shown:
        for vehicle in (1, 2, 3, 5):
            shown.event(Event(40.0 + 0.1 * vehicle, "text warning", "GPS glitch", vehicle))
            shown.event(Event(40.0 + 0.1 * vehicle, "text", "Landing detected", vehicle))
        shown.event(Event(50.0, "text warning", "GPS glitch", 9))
    text = printed(console)
    assert "vehicles 1–3, 5: GPS glitch" in text
    assert "vehicle 9: GPS glitch" in text
    assert "Landing detected" not in text


def test_levels_of_events() -> None:
    assert log_level(Event(0.0, "failure", "a")) == "ERROR"
    assert log_level(Event(0.0, "outcome", "failed: b")) == "ERROR"
    assert log_level(Event(0.0, "outcome", "done: tied")) == "INFO"
    assert log_level(Event(0.0, "hold", "c")) == "WARN"


def test_problems_of_a_vehicle_are_in_its_row() -> None:
    good = snapshot_at(PLAN, 50.0)
    position = good.position.copy()
    position[1] += 1.0
    position[2] = np.nan
    age = good.link_age.copy()
    age[3], age[4] = 7.0, np.inf
    battery = good.battery.copy()
    battery[5] = np.nan
    bad = replace(good, position=position, link_age=age, battery=battery)
    console = plain()
    console.print(team_table(bad, PLAN, 20))
    rows = [line.split() for line in printed(console).splitlines()[1:]]
    assert rows[1][1:3] == ["off", "track"]
    assert rows[2][-1] == "–"
    assert rows[3][1] == "silent"
    assert "7.0" in rows[3]
    assert rows[4][1] == "silent"
    assert "never" in rows[4]
    assert rows[5][5] == "–"


def drawn_at_80_by_24(plan: Plan, shown: Snapshot) -> list[str]:
    console = screen(80, 24)
    with FlightScreen(plan, console, keys=True) as flight:
        for k in range(20):
            flight.event(Event(40.0 + 7 * k, "gate", f"event {k} of a flight with long words " * 4))
        flight.show(shown)
        lines = console.render_lines(flight.drawing(), pad=False)
    return ["".join(part.text for part in line).rstrip() for line in lines]


@pytest.mark.parametrize("number", [13, 19])
def test_all_vehicles_of_large_teams_are_on_a_small_terminal(number: int) -> None:
    nine = snapshot_at(PLAN, 50.0)
    chosen = [k % 9 for k in range(number)]
    many = replace(
        nine,
        **{
            name: getattr(nine, name)[chosen]
            for name in ("position", "velocity", "setpoint", "battery", "link_age")
        },
        **{
            name: tuple(getattr(nine, name)[k] for k in chosen)
            for name in ("modes", "states", "armed", "gripped")
        },
        available=dict.fromkeys(REQUESTS, (True, "")),
    )
    lines = drawn_at_80_by_24(PLAN, many)
    assert len(lines) <= 23
    assert max(map(len, lines)) <= 80
    rows = [line.split() for line in lines]
    for vehicle in range(1, number + 1):
        assert any(str(vehicle) in (row[0], *row[6:7], *row[7:8]) for row in rows if row), lines
    assert lines[-1] == (
        "h hold  r resume  b rewind  l land  x release  j rejoin  a abort  k kill  ^C end"
    )


def test_heights_the_closest_vehicles_and_who_is_missing_are_on_the_screen() -> None:
    shown = snapshot_at(PLAN, 12.0)
    waiting = replace(shown, missing=(2, 3, 7), landing=95.2)
    assert lines_of(clock_line(PLAN, waiting), wait_line(waiting)) == [
        "overhand  grab  0:12.0 of 1:29.0  all landed in 1:35.2  record 0:12.0",
        "waiting, 24 s left, missing 2–3, 7: for all vehicles to grip the cable "
        "(gate before contract)",
    ]
    folding = snapshot_at(PLAN, 50.0)
    first, second = closest_pairs(PLAN, folding.position, cable=False)[0].between
    numbers = f"({first.split()[1]} and {second.split()[1]})"
    assert numbers in margin_line(PLAN, folding).plain
    console = plain()
    console.print(team_table(folding, PLAN, 20))
    rows = [line.split() for line in printed(console).splitlines()[1:]]
    assert [row[3] for row in rows] == [f"{z:.2f}" for z in folding.position[:, 2]]


def test_with_many_vehicles_the_worst_are_listed() -> None:
    errors = np.linspace(0.0, 0.5, 50)
    age = np.full(50, 0.1)
    age[7] = 9.0
    assert worst_vehicles(errors, age, 5) == [7, 47, 48, 49]
    assert worst_vehicles(errors[:4], age[:4], 5) == [0, 1, 2, 3]


def test_formats_of_numbers() -> None:
    assert (metres(1.234), metres(float("nan"))) == ("1.23 m", "–")
    assert (seconds(61.26), seconds(float("inf"))) == ("61.3 s", "–")
    assert [clock(t) for t in (0.0, -0.04, -3.0, 59.96, 65.2)] == [
        "0:00.0",
        "0:00.0",
        "-0:03.0",
        "1:00.0",
        "1:05.2",
    ]
