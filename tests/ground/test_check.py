"""Ground checks through MAVSDK: findings, and parameters that are set and restored."""

import json
import socket
import sys
import threading
import time
from collections import Counter
from dataclasses import replace

import pexpect
import pytest
from pymavlink.dialects.v20 import common

from swarm.certification.findings import Finding, in_common
from swarm.errors import InputError, Interrupted, VehicleError
from swarm.flight.fleet_listener import LinkQuality, radio_finding, radio_findings
from swarm.flight.parameters import stream_loss_model, stream_loss_of
from swarm.flight.snapshot import Checked, Event, Snapshot
from swarm.flight.stages import CheckStep
from swarm.ground.commissioning.check import (
    CheckOptions,
    CheckReport,
    VehicleAudit,
    check,
    save_parameters,
)
from swarm.ground.commissioning.screens import CheckScreens
from swarm.ground.fly import FlightCallbacks, FlyOptions, fly
from swarm.ground.operator import read_screen_line
from swarm.ground.sockets import Links
from swarm.mavlink.fence import polygon
from swarm.mission.fleet import emulated_fleet, parse_fleet
from tests.command import run
from tests.network import small_plan


@pytest.mark.slow
def test_parameters_are_checked_set_and_restored(tmp_path):
    fleet = emulated_fleet(3, ("px4", "ardupilot"))
    shown = []
    options = CheckOptions(soak=2.0, confirm_fix=lambda rows: shown.extend(rows) or True)
    report = check(fleet, tmp_path, small_plan(), options)
    assert report.passed, [f.message for f in report.findings if f.severity == "error"]
    assert report.order == (1, 2, 3)
    assert [item.check for item in report.checklist()] == [
        "fleet", "firmware", "ready", "health", "battery", "position", "parameters", "fence",
        "placement", "origin", "clock", "hold", "stream loss", "link",
    ]  # fmt: skip
    assert all(item.go for item in report.checklist())
    messages = [f.message for f in report.findings]
    assert "system 1: entered Hold and returned" in messages
    assert sum("m up of the first vehicle's" in message for message in messages) == 3
    assert {vehicle.firmware for vehicle in report.vehicles} == {"PX4 1.16.0", "ArduPilot 4.6.2"}
    assert "system 1: COM_OBL_RC_ACT 0 → 5" in report.parameters_set
    assert "system 2: GUID_TIMEOUT 3 → 0.5" in report.parameters_set
    assert [row for vehicle in report.vehicles for row in vehicle.deviations if row.value] == []
    assert {row.name for row in shown} >= {"COM_OBL_RC_ACT", "FS_GCS_ENABLE"}
    saved = json.loads((tmp_path / "parameters" / "1.json").read_text())
    assert saved["COM_OBL_RC_ACT"] == 0
    for link in report.links:
        assert link.rate > 5.0
        assert link.loss < 0.01
        assert link.round_trip < 0.5
    # the emulator starts anew, with its own defaults: nothing else differs from what was saved
    saved["COM_OBL_RC_ACT"] = 4
    (tmp_path / "parameters" / "1.json").write_text(json.dumps(saved))
    restored = check(fleet, tmp_path / "restored", options=CheckOptions(restore=tmp_path))
    assert restored.parameters_set == ("system 1: COM_OBL_RC_ACT 0 → 4",)
    assert not restored.passed
    with pytest.raises(InputError, match="expected the saved parameters of an earlier check"):
        check(fleet, tmp_path / "no", options=CheckOptions(restore=tmp_path / "nowhere"))


class Screen:
    """A screen of a check, in a thread; keeps what it gets and answers what is asked."""

    def __init__(self, folder, answer):
        self.items, self._answer, self._control = [], answer, folder / "control"
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self):
        while not self._control.exists():
            time.sleep(0.02)
        with socket.socket(socket.AF_UNIX) as client, client.makefile("rb") as lines:
            client.connect(str(self._control))
            client.sendall(b"name Anna\nwatch\n")
            for line in lines:
                self.items.append(read_screen_line(line))
                if isinstance(item := self.items[-1], Snapshot) and (say := self._answer(item)):
                    client.sendall(say.encode() + b"\n")

    def of(self, kind):
        self._thread.join()
        return [item for item in self.items if isinstance(item, kind)]


@pytest.mark.slow
def test_a_screen_sees_a_check_and_answers_its_question(tmp_path):
    """The progress, each vehicle's state and what is wrong, the question of --fix, the result."""
    screens = CheckScreens(tmp_path / "control")
    asked = []

    def confirmed(rows):
        with screens.asking(f"sets {len(rows)} parameters") as question:
            while question.answer is None:
                time.sleep(0.02)
        return asked.append(question.answer) or question.answer

    def answer(seen):
        return f"go {seen.time}" if seen.available["go"][0] else "hold" if not asked else ""

    screen = Screen(tmp_path, answer)
    options = CheckOptions(confirm_fix=confirmed, screens=screens)
    report = check(emulated_fleet(2), tmp_path, options=options)
    snapshots = screen.of(Snapshot)
    assert asked == [True]
    # a step may be shorter than the time between two snapshots
    seen = list(dict.fromkeys(shot.phase for shot in snapshots))
    assert seen == [step for step in CheckStep if step in seen]
    assert {"vehicles", "parameters", "result"} <= set(seen) <= {
        "vehicles", "parameters", "places", "Hold mode", "result",
    }  # fmt: skip
    done = [shot.mission_time for shot in snapshots]
    assert done == sorted(done)
    assert done[-1] == 4.0
    assert snapshots[-1].numbers == (1, 2)
    assert snapshots[-1].states == ("ready", "ready")
    wrong = {shot.problems[0] for shot in snapshots}
    assert any(words.startswith("COM_OBL_RC_ACT is 0") for words in wrong), wrong
    assert any(str(shot.waiting_for).startswith("parameters: ") for shot in snapshots)
    last = screen.of(Checked)[-1]
    assert last.findings == report.findings
    assert last.steps == ("vehicles", "parameters", "places", "Hold mode", "result")
    answers = set(screen.of(str))
    assert "no vehicle flies in a check" in answers
    assert any(words.startswith("sets ") for words in answers)
    assert any("go by Anna: sets " in event.message for event in screen.of(Event))
    assert json.loads((tmp_path / "summary.json").read_text()) == {
        "outcome": "GO for flight", "explanation": "", "exit_code": 0,
    }  # fmt: skip
    assert not (tmp_path / "control").exists()


def test_an_answer_counts_for_its_own_question_only():
    """Screen and terminal answer at once: the first counts, and the next question is open."""
    screens = CheckScreens()
    with screens.asking("sets these 3 parameters") as first:
        assert screens.request("go", "Anna") == "sets these 3 parameters"
        assert not first.settle(False)
        assert screens.request("go", "Ben") == "nothing is asked now"
    with screens.asking("sets these 2 parameters") as second:
        assert second.settle(False)
        assert not screens.available()["go"][0]
    assert (first.answer, second.answer) == (True, False)


def test_a_screen_ends_a_check(tmp_path):
    screens = CheckScreens(tmp_path / "control")
    screen = Screen(tmp_path, lambda _: "interrupt")
    with pytest.raises(Interrupted, match=r"^ended by Anna$"):
        check(emulated_fleet(2), tmp_path, options=CheckOptions(screens=screens))
    assert "ends the check: no vehicle is armed" in screen.of(str)
    ended = json.loads((tmp_path / "summary.json").read_text())
    assert (ended["outcome"], ended["exit_code"]) == ("interrupted", 130)


def test_a_file_for_the_console_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "fleet.json").mkdir()
    options = CheckOptions(screens=CheckScreens(tmp_path / "control"))
    with pytest.raises(InputError) as refused:
        check(emulated_fleet(2), tmp_path, options=options)
    assert str(refused.value) == f"{tmp_path}/fleet.json: is a directory"


def test_a_console_of_a_check_has_no_hop():
    done = run("check", "overhand", "--hop", "--console")
    assert (done.returncode, done.stderr.strip()) == (
        2, "--console: its page ends before a hop: check first, then fly the hop without it"
    )  # fmt: skip


@pytest.mark.slow
def test_a_flight_with_autopilot_defaults_is_refused_by_the_audit(tmp_path):
    snapshots = []
    result = fly(
        small_plan(),
        emulated_fleet(3),
        tmp_path / "record",
        FlyOptions(audit=True),
        FlightCallbacks(on_snapshot=snapshots.append),
    )
    waits = {snapshot.waiting_for for snapshot in snapshots}
    assert "the ground check (health and firmware) and the go" in waits
    assert result.outcome.word == "refused"
    assert "NAV_RCL_ACT is 2, should be 1 (hold) or 3 (land)" in result.outcome.explanation
    assert "armed" not in {event.kind for event in result.events}


def test_missing_vehicles_are_named(tmp_path):
    fleet = emulated_fleet(2).model_copy(
        update={
            "emulated": None,
            "limits": emulated_fleet(2).limits.model_copy(update={"ready": 1.0}),
        }
    )
    with pytest.raises(VehicleError, match="not received: system 1, system 2"):
        check(fleet, tmp_path)


def test_a_slow_radio_is_reported_with_the_number_that_fits():
    finding = radio_finding(19, 20.0, 57_600, signed=False)
    assert finding.severity == "error"
    assert "at this rate 2 vehicles fit" in finding.message
    assert "at this rate 2 vehicles fit, and 19 at 2.9 Hz" in finding.message
    assert radio_finding(9, 4.0, 57_600, signed=False).severity == "info"


def test_serial_ports_and_stated_capacities_are_checked():
    text = """
schema: 1
name: radio
links: {usb: "serial:///dev/ttyUSB0:57600", air: "udpin://127.0.0.1:14550"}
capacity: {air: 1000}
vehicles: [{sysid: 1, links: [usb]}, {sysid: 2, links: [usb]}, {sysid: 3, links: [air]}]
"""
    fast, slow = radio_findings(parse_fleet(text, "radio.yaml"), 3)
    assert slow.severity == "error"
    assert slow.message == (
        "link usb: setpoints for 2 vehicles at 20 Hz and positions at 10 Hz need 27.2 kbit/s, "
        "59% of 46.08 kbit/s; at this rate 1 vehicle fits, and 2 at 16.0 Hz"
    )
    assert fast.severity == "info"


def test_gaps_beyond_the_stream_timeout_are_errors():
    bad = LinkQuality(3, 12.0, 0.8, 0.2, 0.05).findings(0.5)
    assert [finding.severity for finding in bad] == ["info", "error", "warning"]
    assert len(LinkQuality(3, 12.0, 0.2, 0.0, 0.05).findings(0.5)) == 1


@pytest.mark.slow
def test_parameters_are_requested_once_and_progress_is_reported(tmp_path, monkeypatch):
    requests: Counter[tuple[int, int]] = Counter()
    send = Links.send

    def watched(self, outgoing):
        packets = list(outgoing)
        for one in packets:
            for message in common.MAVLink(None).parse_buffer(one.data) or []:
                requests[message.get_msgId(), getattr(message, "target_system", 0)] += 1
        send(self, packets)

    monkeypatch.setattr(Links, "send", watched)
    reported = []
    options = CheckOptions(
        confirm_fix=lambda _: True,
        progress=lambda step, share: reported.append((step, share)),
    )
    report = check(emulated_fleet(2, ("px4", "ardupilot")), tmp_path, options=options)
    for vehicle in report.vehicles:
        lists = requests[common.MAVLINK_MSG_ID_PARAM_REQUEST_LIST, vehicle.system]
        sets = requests[common.MAVLINK_MSG_ID_PARAM_SET, vehicle.system]
        changed = [
            one for one in report.parameters_set if one.startswith(f"system {vehicle.system}:")
        ]
        assert lists == 1
        assert 0 < len(changed) <= sets < 2 * len(changed)
        assert [row for row in vehicle.deviations if row.value is not None] == []
    steps = " ".join(step for step, _ in reported)
    for words in ("received 2 of 2 vehicles", "parameters: ", "setting parameters: ",
                  "health and firmware: 2 of 2 vehicles", "testing Hold"):  # fmt: skip
        assert words in steps
    assert all(0.0 <= share <= 1.0 for _, share in reported)


@pytest.mark.slow
def test_a_parameter_that_is_not_set_is_named_with_its_value(tmp_path):
    saved = tmp_path / "parameters" / "1.json"
    saved.parent.mkdir()
    saved.write_text('{"COM_OBL_RC_ACT": 0.5, "COM_OF_LOSS_T": 0.25}')
    with pytest.raises(VehicleError) as error:
        check(emulated_fleet(1), tmp_path / "record", options=CheckOptions(restore=tmp_path))
    assert str(error.value) == "system 1: COM_OBL_RC_ACT was set to 0.5, but is 0"


@pytest.mark.slow
def test_progress_is_shown_on_a_terminal(tmp_path):
    code = "from swarm.cli.main import main; main()"
    program = ["-c", code, "check", "--record", str(tmp_path)]
    terminal = pexpect.spawn(sys.executable, program, encoding="utf-8", timeout=60)
    for words in ("received 9 of 9", "parameters: ", "health and firmware: "):
        terminal.expect(words)
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert terminal.exitstatus == 0  # the default fleet is ready


@pytest.mark.slow
def test_the_default_fleet_is_go_for_a_plan(tmp_path):
    # A plan of no other test: what was computed in a process is not computed again.
    plan, shown = small_plan(height=5.2), []
    options = CheckOptions(prepared=True, progress=lambda words, _: shown.append(words))
    report = check(emulated_fleet(3, ("px4", "ardupilot")), tmp_path, plan, options)
    assert report.passed, [f.message for f in report.findings if f.severity == "error"]
    assert report.parameters_set == ()
    # for other vehicles than the plan's it takes minutes
    assert shown[-1] == "computing what lost setpoints of these vehicles lead to"


def test_what_lost_setpoints_lead_to_is_not_computed_again_for_the_vehicles_of_the_plan():
    flight_plan, limits = small_plan(), emulated_fleet(3).limits
    alike, other = (stream_loss_model(3 * [(kind, {})], limits) for kind in ("px4", "ardupilot"))
    assert stream_loss_of(flight_plan, alike) is flight_plan.stream_loss
    assert stream_loss_of(flight_plan, other).model == other


def test_a_vehicle_whose_parameters_were_not_all_read_is_no_go(tmp_path):
    words = "880 of 897 of its parameters received, then none for 5 s"
    audit = VehicleAudit(3, "PX4", {}, 90.0, 12, (), {"COM_OBL_RC_ACT": 5.0}, (), (), words)
    errors = [one.message for one in audit.findings() if one.severity == "error"]
    assert errors == [f"system 3: {words}"]
    save_parameters(tmp_path, [audit, replace(audit, system=4, unread="")])
    assert [file.name for file in (tmp_path / "parameters").iterdir()] == ["4.json"]


FENCED = "workspace.fence=[[-30, -30], [30, -30], [30, 30], [-30, 30]]"


@pytest.mark.slow
def test_the_missions_fence_is_uploaded_and_the_one_before_restored(tmp_path):
    fleet, plan = emulated_fleet(3, ("px4", "ardupilot")), small_plan(FENCED)
    report = check(fleet, tmp_path / "first", plan, CheckOptions(prepared=True))
    has_none = "has no fence; swarm check MISSION --fence uploads the mission's"
    assert fence_messages(report) == [f"system {k}: {has_none}" for k in (1, 2, 3)]
    options = CheckOptions(fence=True, confirm_fix=lambda _: True, restore=tmp_path / "first")
    report = check(fleet, tmp_path / "second", plan, options)
    # the action of a fence counts once it is enabled, in the same check
    assert "system 2: FENCE_ACTION 1 → 0" in report.parameters_set
    assert report.passed, [f.message for f in report.findings if f.severity == "error"]
    assert fence_messages(report) == [f"system {k}: has the mission's fence" for k in (1, 2, 3)]
    assert "system 1: fence of 4 items uploaded" in report.parameters_set
    assert "system 2: FENCE_ENABLE 0 → 1" in report.parameters_set
    assert json.loads((tmp_path / "second" / "fences" / "1.json").read_text()) == []
    # a fence that was saved is another one than the mission's
    path = tmp_path / "second" / "fences" / "3.json"
    items = [item._asdict() for item in polygon([(47.3, 8.5), (47.3, 8.6), (47.5, 8.6)])]
    path.write_text(json.dumps(items))
    options = CheckOptions(restore=path.parent.parent, prepared=True)
    restored = check(fleet, tmp_path / "third", plan, options)
    assert "system 3: fence of 3 items uploaded" in restored.parameters_set
    assert fence_messages(restored)[2] == (
        "system 3: has another fence than the mission's (3 items): swarm check MISSION --fence "
        "replaces it"
    )
    path.write_text('{"command": 1}')
    with pytest.raises(InputError, match="expected the saved fence of an earlier check"):
        check(fleet, tmp_path / "no", options=CheckOptions(restore=path.parent.parent))


def fence_messages(report):
    return [finding.message for finding in report.findings if finding.check == "fence"]


@pytest.mark.slow
def test_a_fence_that_cannot_be_uploaded_is_no_go_in_words(tmp_path):
    fleet, options = emulated_fleet(2), CheckOptions(fence=True, prepared=True)
    (message,) = unfenced(check(fleet, tmp_path, small_plan(vehicles=2), options))
    assert message == "not uploaded: the mission has none (workspace.fence)"
    pads = fleet.model_copy(update={"frame": "pads"})
    report = check(pads, tmp_path, small_plan(FENCED, vehicles=2), options)
    assert unfenced(report) == ["not uploaded: in the frame pads it has no place on the earth"]
    # and what needs such a place is no warning there
    vehicle, _ = report.vehicles
    assert list(vehicle.health) == ["gyroscope", "accelerometer", "magnetometer", "local position"]


def unfenced(report):
    errors = [finding for finding in report.findings if finding.severity == "error"]
    assert {finding.check for finding in errors} == {"fence"}
    return [finding.message for finding in errors]


def test_every_error_of_a_flight_is_a_row_of_the_list():
    landing = Finding(
        "error", "stream loss", "when all setpoints end, vehicle 2 would land at once"
    )
    (row,) = CheckReport((), (), (), (landing,)).checklist()
    assert (row.subject, row.go, row.message) == ("lost setpoints", False, landing.message)


def test_equal_findings_of_many_vehicles_are_one_line():
    words = [Finding("info", "battery", f"system {k}: 100 %") for k in (1, 2, 4)]
    other = Finding("warning", "failed vehicle", "release it at once", 78.5)
    together = Finding("info", "battery", "systems 1–2, 4: 100 %")
    assert in_common([*words[:2], other, words[2]]) == [together, other]
