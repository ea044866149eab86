"""The walk-through in docs/ runs from top to bottom, and prints the output that it shows."""

import re
import shutil
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import swarm
from tests.golden.plans import RELATIVE

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "walkthrough.md"
_FIGURE = re.compile(r"-?\d+(?:\.\d+)?(?= (?:m|s|m/s)\b)")
_BLOCK = re.compile(r"(<!-- front door -->\n)?```(python|text)\n(.*?)```", re.DOTALL)


def blocks():
    """Return kind and text of every block of code but the lines at the top."""
    return [(kind, text) for mark, kind, text in _BLOCK.findall(PAGE.read_text()) if not mark]


def lines_at_the_top():
    (found,) = [text for mark, _, text in _BLOCK.findall(PAGE.read_text()) if mark]
    return found


def run(text, names):
    out = StringIO()
    with redirect_stdout(out):
        exec(compile(text, str(PAGE), "exec"), names)  # noqa: S102 - our own page
    return out.getvalue()


def assert_alike(printed, shown):
    """Equal, but for lengths, times and speeds: by 5 %, as plans of another CPU (tests/golden)."""
    assert _FIGURE.sub("0", printed) == _FIGURE.sub("0", shown)
    found, expected = ([float(n) for n in _FIGURE.findall(text)] for text in (printed, shown))
    assert found == pytest.approx(expected, rel=RELATIVE["duration, s"]), printed


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the missions and no display, in which the page's code runs."""
    shutil.copytree(ROOT / "missions", tmp_path / "missions")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return tmp_path


@pytest.mark.slow
def test_the_walk_through_runs_and_prints_its_output(folder):
    names, printed = {}, ""
    for kind, text in blocks():
        if kind == "text":
            assert_alike(printed, text)
        else:
            printed = run(text, names)
    for name in ("overhand.plan", "trials.parquet", "mine.csv", "overhand.png", "flight.png"):
        assert (folder / name).stat().st_size > 500, name


def given(folder):
    """The inputs of the lines at the top: a motion of three vehicles, and a curve."""
    places = [[[0, 0, 4], [3, 0, 4], [5.6, 0, 4]], [[0, 2, 4], [3, 2, 4], [5.6, 2, 4]]]
    mission = folder / "three.yaml"
    mission.write_text(
        f"{{schema: 1, name: three, formation: {{lengths: [3.4, 3.1], places: {places}}}}}"
    )
    swarm.plan(swarm.load(mission)).to_csv("mine.csv")
    turn = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    right = [
        np.sin(turn) + 2 * np.sin(2 * turn),
        np.cos(turn) - 2 * np.cos(2 * turn),
        -np.sin(3 * turn),
    ]
    return {"curve": np.column_stack([*right[:2], right[2]])[:-1]}


def through_the_door(text, folder):
    names = given(folder)
    with pytest.warns(UserWarning, match="no display here, so no viewer is opened"):
        run(text, names)
    plan, t = names["plan"], names["t"]
    assert names["certificate"].cleared
    assert names["certificate"].of(plan)
    for array in (names["position"], names["velocity"], names["acceleration"]):
        assert array.shape == (len(t), plan.vehicles, 3)
    assert names["cable"].shape == (plan.vehicles - 1, 100, 3)
    assert np.isfinite(names["cable"]).all()
    assert names["flight"].outcome == "done"
    assert names["foreign"].cleared
    return names


@pytest.mark.slow
def test_the_lines_at_the_top_run_with_a_small_mission(folder):
    text = lines_at_the_top()
    for long, short in (
        ("missions/overhand.yaml", "missions/first-steps/two_carry.yaml"),
        ("trials=200, jobs=2", "trials=1, jobs=1"),
    ):
        assert text.count(long) == 1
        text = text.replace(long, short)
    names = through_the_door(text, folder)
    assert [trial.number for trial in names["trials"]] == [0]


@pytest.mark.full
def test_the_lines_at_the_top_run_exactly_as_they_are(folder):
    names = through_the_door(lines_at_the_top(), folder)
    assert names["flight"].knot == "3_1 right-handed"
    assert len(names["trials"]) == 200
    assert "3_1 right-handed" in repr(names["plan"])
