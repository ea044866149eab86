"""The view in space of a plan's and a flight's page: its data, and the view in a real browser."""

import base64
import json
import re
import subprocess
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm.mission.mission import CylinderObstacle
from swarm.planning.cable_shape import cable_shape
from swarm.reports import motion_view, scene
from swarm.reports.motion_view import MAX_BYTES, flown_motion, planned_motion
from tests.reports.synthetic import trefoil_plan
from tests.reports.test_report import (
    BROWSER,
    PLAN,
    cleared_plan_report,
    made_flight_report,
    outcome,
    trace,
)
from tests.reports.test_terminal import assessment


def decoded(data: dict[str, Any], key: str) -> np.ndarray:
    """Return the places in metres, NaN where unknown, as the script decodes them."""
    stored = np.frombuffer(base64.b64decode(data[key]), dtype="<i2").reshape(data["frames"], -1, 3)
    metres: np.ndarray = stored * data["unit"] + np.array(data["centre"])
    metres[stored == data["unknown"]] = np.nan
    return metres


def test_the_frames_of_a_plan_are_its_motion_and_its_catenaries() -> None:
    view = planned_motion(PLAN, assessment())
    data = json.loads(view.data)
    times = np.linspace(data["start"], data["end"], data["frames"])
    assert np.diff(times).max() <= 0.2 + 1e-9
    np.testing.assert_allclose(
        decoded(data, "places"), PLAN.motion.at(times)[0], atol=data["unit"] * 0.51 + 1e-4
    )
    cable = cable_shape(PLAN, times, data["points"]).reshape(data["frames"], -1, 3)
    np.testing.assert_allclose(
        decoded(data, "strands"), cable, atol=data["unit"] * 0.51 + 1e-4, equal_nan=True
    )
    assert data["unit"] < 0.001  # a millimetre in this field
    assert data["shown"] == PLAN.phase("fold").end
    assert [span.name for span in view.spans] == [phase.name for phase in PLAN.phases]


def test_the_view_has_the_edges_of_fence_and_obstacles() -> None:
    assert json.loads(planned_motion(PLAN, assessment()).data)["lines"] == []
    plan = trefoil_plan(fence=((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0)))
    post = CylinderObstacle(name="post", shape="cylinder", centre=(0, 9), radius=0.5, top=4)
    workspace = plan.mission.workspace.model_copy(update={"obstacles": (post,)})
    plan = replace(plan, mission=plan.mission.model_copy(update={"workspace": workspace}))
    edges = [strip for strips in scene.workspace_lines(plan).values() for strip in strips]
    drawn = json.loads(planned_motion(plan, assessment()).data)["lines"]
    assert [len(strip) for strip in drawn] == [len(strip) for strip in edges]
    np.testing.assert_allclose(np.vstack(drawn), np.vstack(edges), atol=0.0006)


def test_the_moments_of_a_plan_have_their_times_and_objects() -> None:
    cable, vehicle = planned_motion(PLAN, assessment()).moments  # the third has no distance
    assert (cable.time, cable.between) == (51.3, ("segment 3", "segment 5"))
    assert cable.words == "0.21 m certified, segments 3 and 5, 51.3 s"
    assert vehicle.words == "1.20 m certified, vehicles 5 and 7, 44.0 s"


def test_a_long_motion_has_fewer_frames_and_keeps_to_the_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(motion_view, "MAX_BYTES", 50_000)
    data = json.loads(planned_motion(PLAN, assessment()).data)
    size = decoded(data, "places").size + decoded(data, "strands").size
    assert 45_000 < 2 * size <= 50_000 < MAX_BYTES


def test_a_flight_shows_reported_positions_and_the_implied_cable_on_its_own_clock() -> None:
    flown = trace()
    view = flown_motion(PLAN, outcome(), flown)
    assert view is not None
    assert (view.start, view.end) == (3.0, PLAN.duration + 3.0)
    data = json.loads(view.data)
    places = decoded(data, "places")
    assert np.isnan(places[0, 2]).any()  # the first positions of vehicle 3 are not reported
    np.testing.assert_allclose(places[-1], flown.position[-1], atol=0.001)
    strands = decoded(data, "strands").reshape(data["frames"], data["segments"], -1, 3)
    held = round((PLAN.phase("hold").start - view.start + 4.0) / 0.2)
    np.testing.assert_allclose(strands[held, :, 0], places[held, :-1], atol=0.002)
    assert np.isnan(strands[-1]).all()  # the shape of released cable is not known
    both = view.moments[0]
    assert both.time == pytest.approx(54.0, abs=0.3)
    assert both.words == "0.30 m flown, segments 3 and 5, mission time 51.0 s"


def test_the_cable_is_not_drawn_in_a_contingency() -> None:
    flown = trace()
    ended = replace(
        flown,
        mission_time=np.minimum(flown.mission_time, 50.0),
        phase=tuple(
            name if time < 50.0 else ""
            for name, time in zip(flown.phase, flown.mission_time, strict=True)
        ),
    )
    view = flown_motion(PLAN, outcome(), ended)
    assert view is not None
    data = json.loads(view.data)
    strands = decoded(data, "strands").reshape(data["frames"], -1)
    known = np.isfinite(strands).all(axis=1)
    times = np.linspace(data["start"], data["end"], data["frames"]) - 3.0  # the clock's lead
    assert known[(times > 10.0) & (times < 49.0)].all()
    assert not known[times > 51.0].any()


def test_a_flight_without_a_position_has_no_view() -> None:
    blind = replace(trace(), position=np.full_like(trace().position, np.nan))
    assert flown_motion(PLAN, outcome(), blind) is None


# The page is in a frame; the picture is read after each action, in the same task.
DRIVE = """<!doctype html><title>-</title><iframe style="width:%dpx; height:900px; border:0"
srcdoc="%s"></iframe><script>
const errors = [];
const frame = document.querySelector("iframe");
addEventListener("load", () => {
  const page = frame.contentDocument, view = frame.contentWindow;
  view.addEventListener("error", (event) => errors.push(event.message));
  view.console.error = (...words) => errors.push(words.join(" "));
  // Headless Chromium draws no frames in virtual time.
  view.requestAnimationFrame = (act) => setTimeout(() => act(performance.now()), 16);
  const find = (name) => page.querySelector(".motion " + name);
  const space = find(".space"), slider = find("input");
  const look = () => {
    const gl = space.getContext("webgl"), width = space.width, height = space.height;
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let red = 0, dark = 0, sum = 0;
    for (let i = 0; i < pixels.length; i += 4) {
      red += pixels[i] > 100 && Math.max(pixels[i + 1], pixels[i + 2]) < 0.33 * pixels[i];
      dark += pixels[i + 3] > 0 && pixels[i] + pixels[i + 1] + pixels[i + 2] < 300;
      sum = (31 * sum + pixels[i] + 7 * pixels[i + 1]) %% 1000003;
    }
    return { red, dark, sum, now: find(".now").textContent, value: +slider.value };
  };
  const press = (key) => space.dispatchEvent(new view.KeyboardEvent("keydown", { key }));
  const seen = {};
  setTimeout(() => {
    seen.first = look();
    slider.value = 40; slider.dispatchEvent(new view.Event("input"));
    seen.scrubbed = look();
    press("ArrowLeft");
    seen.turned = look();
    space.setPointerCapture = () => {};  // made events have no pointer to capture
    const point = (kind, pointerId, clientX) => space.dispatchEvent(
      new view.PointerEvent(kind, { pointerId, clientX, clientY: 50 }));
    point("pointerdown", 1, 50); point("pointermove", 1, 90);
    seen.dragged = look();
    point("pointerdown", 2, 190); point("pointermove", 2, 150);
    seen.pinched = look();
    point("pointerup", 1, 90); point("pointerup", 2, 150);
    find(".moments button").click();
    setTimeout(() => {
      seen.jumped = look();
      seen.pressed = find(".moments button").getAttribute("aria-pressed");
      find(".whole").click();
      find(".play").click();
      seen.button = find(".play").textContent;
      setTimeout(() => {
        seen.played = look();
        press(" ");
        seen.paused = find(".play").textContent;
        seen.fallback = find(".fallback").checkVisibility();
        seen.wide = find(".stage").getBoundingClientRect().width;
        seen.sideways = page.documentElement.scrollWidth - page.documentElement.clientWidth;
        document.title = JSON.stringify({ ...seen, errors });
      }, 1000);
    }, 1500);
  }, 500);
});</script>"""


def looked_at(file: Path, folder: Path) -> dict[str, Any]:
    """Return what the page says that it shows.

    On a busy machine a browser without a screen can lose its graphics process: every pixel reads as
    transparent then. It is started again, twice at most; a view that draws nothing stays blank.
    """
    for start in range(3):
        ran = subprocess.run(
            [
                str(BROWSER), "--headless", "--no-sandbox", "--enable-unsafe-swiftshader",
                "--enable-logging=stderr", "--dump-dom", "--window-size=1300,1000",
                f"--user-data-dir={folder / f'profile{start}'}", "--virtual-time-budget=8000",
                file.as_uri(),
            ],
            check=True, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        assert not re.findall(r"Uncaught.*|.*:ERROR:CONSOLE.*", ran.stderr)
        seen: dict[str, Any] = json.loads(ran.stdout.split("<title>")[1].split("</title>")[0])
        if seen["first"]["dark"] > 0:
            break
    return seen


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs a Chromium to look with")
@pytest.mark.parametrize("width", [390, pytest.param(1280, marks=pytest.mark.full)])
@pytest.mark.parametrize("made", [cleared_plan_report, made_flight_report])
def test_a_browser_turns_scrubs_and_plays_the_motion(made: Any, width: int, tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text(DRIVE % (width, escape(made())), encoding="utf-8")
    seen = looked_at(file, tmp_path)
    assert seen["errors"] == []
    assert not seen["fallback"]
    assert seen["sideways"] == 0
    assert 0.75 * min(width, 990) < seen["wide"] < width
    assert seen["first"]["dark"] > 200  # cable and vehicles are drawn
    assert seen["first"]["red"] == 0
    assert seen["scrubbed"]["now"].startswith("40.0 s, ")
    pictures = [seen[key]["sum"] for key in ("first", "scrubbed", "turned", "dragged", "pinched")]
    assert len(set(pictures)) == len(pictures)
    tight = float(re.search(r'data-time="([\d.]+)"', made())[1])  # type: ignore[index]
    assert seen["jumped"]["value"] == pytest.approx(tight, abs=1e-6)
    assert seen["jumped"]["now"] == f"{tight:.1f} s, fold"
    assert seen["jumped"]["red"] > 50  # both strands
    assert seen["pressed"] == "true"
    assert seen["button"] == "Pause"
    assert seen["played"]["red"] == 0
    assert seen["played"]["value"] > tight + 1.0
    assert seen["paused"] == "Play"
