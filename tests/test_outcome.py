"""The outcome of flights without cable, without a knot, or that end before the fold."""

import io

import pytest
from rich.console import Console

from swarm.flight.trace import Trace
from swarm.reports.flight import flight_report, print_verification, verification_object
from swarm.verification import verify_trace
from tests.command import run
from tests.network import small_plan
from tests.reports.test_report import Reader, outcome


@pytest.fixture(scope="module")
def hover(tmp_path_factory):
    page = tmp_path_factory.mktemp("hover") / "report.html"
    said = run("dry-run", "missions/first-steps/hover.yaml", "--report", str(page))
    return said, Reader(page.read_text()).words


@pytest.mark.slow
def test_a_flight_without_cable_has_no_line_on_knots_and_distances_of_vehicles_alone(hover):
    said, words = hover
    assert said.returncode == 0
    after = said.stdout.split("phase finished\n")[1].splitlines()
    assert after[0] == "Done: all vehicles have landed and disarmed."
    assert after[2].startswith("vehicle to ceiling")
    assert after[3].startswith("Tracking error in the fold: 0.0")
    assert len(after) == 5
    assert "quasi-static" not in said.stdout
    assert said.stdout.splitlines()[0] == (
        "Cleared: distances between vehicles, tracking errors up to 0.10 m. "
        "Not certified: gusts, rotor wash."
    )
    assert "Planned knot: no knot" in words
    assert "imply" not in words
    assert "Smallest distances" in words
    assert "cable to" not in words


def test_a_flight_that_ends_before_the_fold_has_no_table_of_distances():
    flight_plan = small_plan()
    positions = flight_plan.plan.motion.at(0.0)[0][None]
    trace = Trace(*[positions[:, 0, 0]] * 2, positions, positions, ("takeoff",))
    flown = verify_trace(flight_plan.plan, trace)
    console = Console(file=io.StringIO(), width=100)
    document = verification_object(flown, flight_plan.assessment)
    print_verification(flight_plan.plan, document, console)
    assert console.file.getvalue().splitlines() == [
        "The knot of the cable is unknown (planned: 0_1)",
        "The fold was not flown: it has no tracking error",
        "note no positions were reported in the hold",
    ]
    told = outcome(**document, outcome="failed", explanation="down")
    words = Reader(flight_report(flight_plan.plan, flight_plan.assessment, told, trace, [])).words
    assert "Failed: down. The knot of the cable is not known." in words
    assert "Smallest distances" not in words
    assert "unknown" not in words
