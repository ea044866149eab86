"""The test hop of ``swarm check``, flown through sockets by the emulator's process."""

import io
import json

import pytest
from rich.console import Console

from swarm.flight.hop import HOVER, hop
from swarm.ground.callbacks import FlightCallbacks
from swarm.ground.hop import fly_hop
from swarm.mission.fleet import emulated_fleet
from swarm.reports.check_json import hop_object
from swarm.reports.terminal import FlightScreen
from tests.network import small_plan


@pytest.mark.usefixtures("in_real_time")
def test_a_hop_reports_hover_errors_and_the_tracking_error_to_plan_with(tmp_path):
    console = Console(file=io.StringIO(), width=100)
    plan = small_plan()
    flight = hop(plan)
    with FlightScreen(flight.plan, console) as screen:
        result = fly_hop(
            flight,
            plan,
            emulated_fleet(3),
            tmp_path / "hop",
            speed=8.0,
            callbacks=FlightCallbacks(on_snapshot=screen.show, on_event=screen.event),
        )
    advice, *each = [finding.message for finding in result.findings]
    assert advice.startswith("plan with vehicles.tracking of 0.")
    assert [words.split(" m RMS")[0].split("0.")[0] for words in each] == [
        f"vehicle {number}: level " for number in (1, 2, 3)
    ]
    document = json.loads(json.dumps(hop_object(result)))
    assert 0.0 < document["recommended_tracking"] < 0.5
    for one in document["vehicles"]:
        assert one["seconds"] > 0.9 * HOVER
        assert 0.0 < one["level"]["rms"] <= one["level"]["largest"] <= one["both"]["largest"]
        assert 0.0 < one["up"]["rms"] <= one["up"]["largest"]
    assert "phase hold" in console.file.getvalue()
    assert (tmp_path / "hop" / "summary.json").exists()
