"""Draw the gallery: for every mission figures, a moving picture, and the folded knot.

    python missions/gallery.py [FOLDER] [MISSION.yaml …]

Without arguments, all missions of this folder go into pictures/. The pictures of knots are rendered
by Rerun without a screen (Debian: mesa-vulkan-drivers); without it there are figures only.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter1d

from swarm import planner
from swarm.certification.swing_runs import aloft, swings
from swarm.errors import Refused
from swarm.mission import parse_mission
from swarm.planning import Plan
from swarm.planning.cable_shape import cable_shape
from swarm.planning.candidates import make_plan
from swarm.reports.plots import (
    END,
    INK,
    START,
    STYLE,
    Axes,
    along_colours,
    new_axes,
    plan_figure,
    save,
    schedule_figure,
)
from swarm.view.replay import write_plan
from swarm.view.screenshot import ScreenshotFailed, screenshot

HERE = Path(__file__).parent
Floats = npt.NDArray[np.float64]

FRAMES_PER_SECOND = 10
_POINTS = 24
"""Points of a segment: its links are then shorter than a pixel row is high."""
_LAST_FRAMES = 12
"""Frames for which the folded cable is shown."""
_SMOOTHING = 5.0
"""Standard deviation of the camera's smoothing, in frames."""
_TURN = 50.0
"""Degrees by which the camera turns around the team, so that depth can be seen."""


def draw(plan: Plan, folder: Path) -> list[Path]:
    """Write a plan's pictures; returns their paths."""
    name = plan.mission.name
    drawn = [folder / f"{name}-plan.png", folder / f"{name}-schedule.png"]
    save(plan_figure(plan), drawn[0])
    save(schedule_figure(plan), drawn[1])
    if any(phase.name == "fold" for phase in plan.phases):
        drawn.append(folder / f"{name}.gif")
        animate_plan(plan, drawn[-1])
        if plan.layout.lengths.size and plan.mission.fold.method != "paper":
            drawn.append(folder / f"{name}-swing.png")
            # that plan is neither shaped nor slowed yet
            save(shaping_figure(plan, make_plan(plan.mission)), drawn[-1])
    with tempfile.TemporaryDirectory() as scratch:
        recording = Path(scratch) / "plan.rrd"
        write_plan(plan, recording)
        picture = folder / f"{name}-held.png"
        try:
            screenshot([recording], picture, at=plan.phase("hold").start)
            drawn.append(picture)
        except ScreenshotFailed as error:
            print(f"no picture of {name} held: {error}")
    return drawn


@mpl.rc_context(STYLE)
def shaping_figure(shaped: Plan, time_optimal: Plan) -> Figure:
    """Return the planned swing of a plan, and of the same knot's time-optimal fold.

    Raises :class:`swarm.errors.Refused` where a plan folds no cable.
    """
    figure, axes = new_axes((8.0, 3.0))
    for plan, words, colour in (
        (time_optimal, "time-optimal", START), (shaped, "as planned", END)
    ):  # fmt: skip
        _draw_planned_swing(axes, plan, words, colour)
    since = "time since the beginning of the fold, s (dotted: its end)"
    axes.set(xlabel=since, ylabel="largest stray, m")
    axes.set_title("Swing of the cable in fold and hold, vehicles exactly on the plan")
    axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
    axes.set_xlim(left=0.0)
    axes.legend(fontsize=8.0, frameon=False, loc="upper center", ncols=2)
    return figure


def _draw_planned_swing(axes: Axes, plan: Plan, words: str, colour: object) -> None:
    span = aloft(plan)
    if span is None:
        raise Refused(f"{plan.mission.name}: the plan folds no cable")
    planned = next(swings(plan, span))
    fold, hold = plan.phase("fold"), plan.phase("hold")
    stray = np.linalg.norm(planned.strays[0], axis=-1).max(axis=(1, 2))
    shown = planned.times[0] <= hold.end
    time = planned.times[0][shown] - fold.start
    words = f"{words}: {fold.duration:.0f} s, at most {stray[shown].max():.2f} m"
    axes.plot(time, stray[shown], color=colour, linewidth=1.2, label=words)
    axes.axvline(fold.duration, color=colour, linewidth=0.8, linestyle=":")


@mpl.rc_context(STYLE)
def animate_plan(plan: Plan, path: Path, frames: int = 90) -> None:
    """Write the lift, fold and hold of a plan as an animated GIF of a few hundred kilobytes.

    ``frames`` are evenly spaced in mission time. Raises :class:`KeyError` for a plan without fold.
    """
    fold = plan.phase("fold")
    begin = plan.phase("lift").start if any(p.name == "lift" for p in plan.phases) else fold.start
    times = np.linspace(begin, fold.end, frames)
    places = plan.motion.at(times)[0]
    cable = cable_shape(plan, times, _POINTS)
    centre, size = _frame(places, cable)
    figure = Figure(figsize=(5.6, 4.0))
    axes: Any = figure.add_axes((-0.25, -0.3, 1.5, 1.5), projection="3d")
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=0.85)
    axes.set_axis_off()
    colours = along_colours(cable.shape[1])
    shadows: list[Any] = [
        axes.plot([], [], [], color=INK, alpha=0.15, linewidth=2.0)[0] for _ in colours
    ]
    strands: list[Any] = [
        axes.plot([], [], [], color=colour, linewidth=2.4)[0] for colour in colours
    ]
    vehicles = axes.plot([], [], [], "o", color=INK, markersize=5)[0]
    label = figure.text(0.03, 0.93, "", color=INK)

    def show(frame: int) -> list[Any]:
        k = min(frame, frames - 1)
        low, high = centre[k] - 0.5 * size[k], centre[k] + 0.5 * size[k]
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        for strand, shadow, points in zip(strands, shadows, cable[k], strict=True):
            strand.set_data_3d(*points.T)
            shadow.set_data_3d(points[:, 0], points[:, 1], np.zeros(_POINTS))
        vehicles.set_data_3d(*places[k].T)
        axes.view_init(elev=32.0, azim=-75.0 + _TURN * k / frames)
        label.set_text(f"{plan.mission.name}, {times[k] - times[0]:.0f} s")
        return [*strands, *shadows, vehicles]

    moving = FuncAnimation(figure, show, frames=frames + _LAST_FRAMES)
    moving.save(path, writer=PillowWriter(fps=FRAMES_PER_SECOND), dpi=90)


def _frame(places: Floats, cable: Floats) -> tuple[Floats, Floats]:
    """Return the centres (k, 3) and the widths (k, 1) of cubes around the team, smooth over time.

    The cubes reach down to the floor, on which the plan view of the cable is drawn.
    """
    points = np.concatenate([places, cable.reshape(len(cable), -1, 3)], axis=1)
    low, high = points.min(axis=1), points.max(axis=1)
    low[:, 2] = 0.0
    size = (high - low).max(axis=1, keepdims=True)
    return (
        gaussian_filter1d(0.5 * (low + high), _SMOOTHING, axis=0, mode="nearest"),
        gaussian_filter1d(1.05 * size, _SMOOTHING, axis=0, mode="nearest"),
    )


def main(folder: Path, missions: list[Path]) -> None:
    """Plan the missions and draw them."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in missions:
        try:
            result = planner.plan(parse_mission(path.read_text(), str(path)), robustness=False)
        except Refused as refusal:
            print(f"{path}: refused: {refusal}")
            continue
        for picture in draw(result.plan, folder):
            print(picture)


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[1:]]
    main(given[0] if given else HERE / "pictures", given[1:] or sorted(HERE.glob("*.yaml")))
