"""The test hop of ``swarm check``, flown through sockets by the emulator's process."""

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from swarm.cli.check import _plan_finding, _write_measured
from swarm.flight.bench_flight import HOVER, hop
from swarm.ground.fly import FlightCallbacks
from swarm.ground.hop import fly_hop
from swarm.mission.fleet import emulated_fleet, parse_fleet
from swarm.reports.check import hop_object
from swarm.reports.terminal import FlightScreen
from tests.network import small_plan

FLEET = """\
schema: 1
name: 12_3  # a text, not a number
links: {radio: "udpin://127.0.0.1:14550"}
vehicles:
  - {sysid: 1, links: [radio]}
  - {sysid: 2, links: [radio]}
"""


@pytest.mark.slow
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
            speed=20.0,
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
    key = "signing_key: keys/team.key\n"
    before = f"# in the hall\n{FLEET}{key}"
    fleet = parse_fleet(before, "hall.yaml").model_copy(
        update={"signing_key": "hall/keys/team.key"}
    )
    written = _write_measured(before, fleet, tmp_path, result)
    assert written == tmp_path / "measured-fleet.yaml"
    assert written.read_text() == before.replace(
        key, f"signing_key: {Path('hall/keys/team.key').resolve()}\ntracking: {result.tracking}\n"
    )
    assert _write_measured(None, fleet, tmp_path, result) is None
    assert _write_measured(before, fleet, tmp_path, replace(result, tracking=None)) is None
    assert _write_measured(before, fleet, tmp_path, replace(result, tracking=6.0)) is None


def test_a_plan_for_less_than_was_measured_is_a_no_go():
    plan = small_plan()
    measured = emulated_fleet(3).model_copy(update={"tracking": 0.9})
    finding = _plan_finding(plan, measured)
    assert (finding.severity, finding.check) == ("error", "plan")
    assert "vehicles were measured with a tracking error of 0.9 m" in finding.message
    for fleet in (None, measured.model_copy(update={"gripper": "none"}), emulated_fleet(3)):
        assert _plan_finding(plan, fleet).severity == "info"
