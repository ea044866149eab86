import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import rerun.blueprint as rrb
from click.testing import CliRunner
from PIL import Image

from swarm.cli.view import find_recording, view
from swarm.errors import InputError, SwarmError
from swarm.ground.record_reader import recorded_plan
from swarm.planning import Plan
from swarm.planning.archive import plan_document, plan_motion
from swarm.view import viewers
from swarm.view.blueprint import comparison_blueprint, flight_blueprint, plan_blueprint
from swarm.view.replay import write_plan
from swarm.view.screenshot import ScreenshotFailed, find_view, screenshot
from swarm.view.viewers import DRIVER
from tests import command
from tests.reports.synthetic import trefoil_plan

PLAN = trefoil_plan()


def test_a_record_is_opened_by_its_recording(tmp_path: Path) -> None:
    (tmp_path / "flight.rrd").touch()
    (tmp_path / "plan.json").touch()
    assert find_recording(tmp_path) == tmp_path / "flight.rrd"
    assert find_recording(tmp_path / "flight.rrd") == tmp_path / "flight.rrd"
    assert find_recording(Path("overhand")) is None
    assert find_recording(Path("missions/overhand.yaml")) is None


def test_a_folder_without_a_record_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a flight record with an \.rrd file in it"):
        find_recording(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        find_recording(tmp_path / "flight.rrd")
    with pytest.raises(InputError, match=r"with plan\.json and motion\.npz in it"):
        recorded_plan(tmp_path)
    (tmp_path / "plan.json").write_text("{")
    (tmp_path / "motion.npz").write_bytes(b"")
    with pytest.raises(InputError, match="not valid JSON"):
        recorded_plan(tmp_path)


def test_the_plan_of_a_record_is_read(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(json.dumps(plan_document(PLAN)))
    (tmp_path / "motion.npz").write_bytes(plan_motion(PLAN))
    plan = recorded_plan(tmp_path)
    assert plan.phases == PLAN.phases
    assert plan.layout.crossings == PLAN.layout.crossings


def test_without_a_display_the_alternatives_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (tmp_path / "flight.rrd").write_bytes(b"RRF2")
    answer = CliRunner().invoke(view, [str(tmp_path)])
    assert answer.exit_code == 0
    assert answer.output == ("no display: use --web, or --screenshot for a picture\n")


def test_an_invalid_mission_is_an_input_error(tmp_path: Path) -> None:
    answer = CliRunner().invoke(view, [str(tmp_path / "no.yaml")])
    assert isinstance(answer.exception, SwarmError)


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"", "expected a Rerun recording, got an empty file"),
        (b"\x89PNG\r\n", "expected a Rerun recording, got another kind of file"),
    ],
)
def test_a_file_that_is_no_recording_is_an_error(
    tmp_path: Path, contents: bytes, message: str
) -> None:
    file = tmp_path / "flight.rrd"
    file.write_bytes(contents)
    for how in (["--web"], ["--screenshot", str(tmp_path / "shot.png")]):
        said = command.run("view", str(file), *how)
        assert said == (2, "", f"{file}: {message}\n")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    write_plan(PLAN, tmp_path / "plan.rrd")
    return tmp_path / "plan.rrd"


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files, of processes that are started, too."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def test_without_a_driver_the_reason_is_reported_and_no_file_remains(
    recording: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, str(scratch / "no-driver.json"))
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    picture = recording.parent / "shot.png"
    said = command.run("view", str(recording), "--screenshot", str(picture))
    assert (said.returncode, said.stdout) == (1, "")
    assert said.stderr.startswith("the rerun program ended (exit code ")
    assert said.stderr.endswith(f"; {DRIVER}\n")
    assert not picture.exists()
    assert list(scratch.iterdir()) == []


def program(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a shell script in the place of the rerun program."""
    script = folder / "rerun"
    script.write_text(f"#!/bin/sh\n{text}\n")
    script.chmod(0o755)
    monkeypatch.setattr(viewers, "viewer_binary", lambda: script)


@pytest.mark.parametrize("how", ["--web", "--screenshot"])
@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("exit 3", "(exit code 3): no output"),
        ("echo one >&2; echo two >&2; exit 1", "(exit code 1): two"),
        (
            "printf '\\033[1mbad\\033[0m ERROR disk\\nsee our page\\n' >&2; exit 1",
            "(exit code 1): bad ERROR disk",
        ),
        ("kill -9 $$", "(signal 9): no output"),
    ],
)
def test_the_output_of_a_failed_viewer_is_reported(
    recording: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch, how: str, text: str, end: str
) -> None:
    program(recording.parent, text, monkeypatch)
    arguments = [how, *([str(recording.parent / "shot.png")] if how == "--screenshot" else [])]
    said = command.run("view", str(recording), *arguments)
    about = f"; {DRIVER}" if how == "--screenshot" else ""
    assert said.stderr == f"the rerun program ended {end}{about}\n"
    assert said.returncode == 1
    assert list(scratch.iterdir()) == []


def test_a_viewer_that_cannot_be_started_is_named(
    recording: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program(recording.parent, "", monkeypatch)
    (recording.parent / "rerun").chmod(0o644)
    said = command.run("view", str(recording), "--web")
    assert said == (1, "", f"{recording.parent / 'rerun'} cannot be started: permission denied\n")
    monkeypatch.undo()
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    said = command.run("view", str(recording), "--screenshot", str(scratch / "shot.png"))
    assert said == (1, "", "the rerun program is not installed: pip install rerun-sdk\n")


VIEW = """
import signal
for name in ("SIGTERM", "SIGHUP"):  # they may be ignored here, as by nohup
    signal.signal(getattr(signal, name), signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)
from swarm.cli.main import main
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_the_server_ends_with_the_command(recording: Path, scratch: Path, name: str) -> None:
    """A real process: `swarm view --web`, its server and its folder."""
    with subprocess.Popen(
        [sys.executable, "-c", VIEW, "view", recording, "--web"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        listed = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        if not listed.exists():
            process.kill()
            pytest.skip("this system does not list a process's children")
        children = [int(child) for child in listed.read_text().split()]
        assert children
        assert list(scratch.iterdir())
        process.send_signal(getattr(signal, name))
        try:
            assert process.wait(20.0) == 130
        finally:
            process.kill()  # a test that fails must not wait for it
        left = [child for child in children if runs(child)]
        for child in left:
            os.kill(child, signal.SIGKILL)
        assert left == []
        assert list(scratch.iterdir()) == []
        assert process.stderr.read() == "the viewer has stopped\n"


def runs(process: int) -> bool:
    until = time.monotonic() + 2.0
    with suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.kill(process, 0)
            time.sleep(0.02)
        return True
    return False


def shown_names(blueprint: rrb.Blueprint) -> list[str]:
    def names(part: Any) -> list[str]:
        if isinstance(part, rrb.View):
            return [part.name]
        return [name for inner in part.contents for name in names(inner)]

    return names(blueprint.root_container)


@pytest.mark.parametrize(
    "arrange", [partial(flight_blueprint, live=False), plan_blueprint, comparison_blueprint]
)
def test_views_are_found_by_name_and_listed(
    arrange: Callable[[Plan], rrb.Blueprint],
) -> None:
    names = shown_names(arrange(PLAN))
    assert len(set(names)) == len(names) >= 5
    assert not [name for name in names if set(name) & set(",;\"'$")]
    views = {name: f"id of {name}" for name in names}
    assert [find_view(views, name.lower()) for name in names] == list(views.values())


def test_the_views_named_in_the_help_exist() -> None:
    told = " ".join(command.run("view", "--help").stdout.split())
    assert "Knot or Field (of a flight or a plan), Planned or Flown (with --compare)" in told
    for arrange in (partial(flight_blueprint, live=False), plan_blueprint):
        assert {"Knot", "Field"} <= set(shown_names(arrange(PLAN)))
    assert {"Planned", "Flown"} <= set(shown_names(comparison_blueprint(PLAN)))


def test_an_unknown_view_is_refused_with_the_names_of_all_views() -> None:
    with pytest.raises(ScreenshotFailed) as caught:
        find_view({"Planned": "1", "Flown": "2"}, "Knot")
    assert str(caught.value) == "--only: expected one of the views (Flown; Planned), got Knot"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "Knot"], "--at and --only belong to --screenshot"),
        (["--at", "nan", "--screenshot", "x.png"], "--at: expected seconds from 0 on, got nan"),
        (["--at", "-1", "--screenshot", "x.png"], "--at: expected seconds from 0 on, got -1"),
    ],
)
def test_options_without_effect_are_refused(options: list[str], message: str) -> None:
    said = command.run("view", "plan.rrd", *options)
    assert said.returncode == 2
    assert said.stderr.endswith(f"Error: {message}\n")


@pytest.mark.full
def test_a_picture_of_a_plan(tmp_path: Path) -> None:
    write_plan(PLAN, tmp_path / "plan.rrd")
    try:
        screenshot([tmp_path / "plan.rrd"], tmp_path / "plan.png", at=60.0, size=(800, 600))
    except ScreenshotFailed as error:
        pytest.skip(str(error))
    picture = Image.open(tmp_path / "plan.png").convert("RGB")
    assert picture.width == 800
    assert len(picture.getcolors(1 << 20) or []) > 100
    with pytest.raises(ScreenshotFailed, match=r"expected one of the views \(.*Knot.*\), got Nix"):
        screenshot([tmp_path / "plan.rrd"], tmp_path / "plan.png", view="Nix")
