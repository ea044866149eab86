import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from PIL import Image

from swarm.cli.records import recorded_plan
from swarm.cli.view import find_recording, view
from swarm.errors import InputError, SwarmError
from swarm.flight.archive import plan_document, plan_motion
from swarm.view.replay import write_plan
from swarm.view.screenshot import NoPicture, screenshot
from tests.view.synthetic import trefoil_plan

PLAN = trefoil_plan()


def test_a_record_is_opened_by_its_recording(tmp_path: Path) -> None:
    (tmp_path / "flight.rrd").touch()
    (tmp_path / "plan.json").touch()
    assert find_recording(tmp_path) == tmp_path / "flight.rrd"
    assert find_recording(tmp_path / "flight.rrd") == tmp_path / "flight.rrd"
    assert find_recording(Path("overhand")) is None
    assert find_recording(Path("missions/overhand.yaml")) is None


def test_what_is_no_record_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a record with an \.rrd file in it"):
        find_recording(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        find_recording(tmp_path / "flight.rrd")
    with pytest.raises(InputError, match=r"with plan\.json and motion\.npz in it"):
        recorded_plan(tmp_path)
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        recorded_plan(tmp_path)


def test_a_record_s_plan_comes_back(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(json.dumps(plan_document(PLAN)))
    (tmp_path / "motion.npz").write_bytes(plan_motion(PLAN))
    plan = recorded_plan(tmp_path)
    assert plan.phases == PLAN.phases
    assert plan.layout.crossings == PLAN.layout.crossings


def test_without_a_display_the_ways_out_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (tmp_path / "flight.rrd").touch()
    answer = CliRunner().invoke(view, [str(tmp_path)])
    assert answer.exit_code == 0
    assert answer.output == (
        "no display here; see it with --web, or as a picture with --screenshot\n"
    )


def test_a_mission_that_is_none_is_an_input_error(tmp_path: Path) -> None:
    answer = CliRunner().invoke(view, [str(tmp_path / "no.yaml")])
    assert isinstance(answer.exception, SwarmError)


@pytest.mark.full
def test_a_picture_of_a_plan(tmp_path: Path) -> None:
    write_plan(PLAN, tmp_path / "plan.rrd")
    try:
        screenshot([tmp_path / "plan.rrd"], tmp_path / "plan.png", at=60.0, size=(800, 600))
    except NoPicture as error:
        pytest.skip(str(error))
    picture = Image.open(tmp_path / "plan.png").convert("RGB")
    assert picture.width == 800
    assert len(picture.getcolors(1 << 20) or []) > 100
    with pytest.raises(NoPicture, match=r"expected one of the views .*Knot.*, got Nix"):
        screenshot([tmp_path / "plan.rrd"], tmp_path / "plan.png", view="Nix")
