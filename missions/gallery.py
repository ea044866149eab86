"""Draw the gallery: for every mission figures, a moving picture, and the folded knot.

    python missions/gallery.py [FOLDER] [MISSION.yaml …]

Without arguments, all missions of this folder go into pictures/. The pictures of knots are rendered
by Rerun without a screen (Debian: mesa-vulkan-drivers); without it there are figures only.
"""

import sys
import tempfile
from pathlib import Path

from swarm import planner
from swarm.errors import Refused
from swarm.mission import parse_mission
from swarm.planning import Plan
from swarm.planning.candidates import make_plan
from swarm.reports.animation import animate_plan
from swarm.reports.flight_report import plot_shaping
from swarm.reports.plots import plot_plan
from swarm.reports.schedule_plots import plot_schedule
from swarm.view.replay import write_plan
from swarm.view.screenshot import ScreenshotFailed, screenshot

HERE = Path(__file__).parent


def draw(plan: Plan, folder: Path) -> list[Path]:
    """Write a plan's pictures; returns their paths."""
    name = plan.mission.name
    drawn = [folder / f"{name}-plan.png", folder / f"{name}-schedule.png"]
    plot_plan(plan, drawn[0])
    plot_schedule(plan, drawn[1])
    if any(phase.name == "fold" for phase in plan.phases):
        drawn.append(folder / f"{name}.gif")
        animate_plan(plan, drawn[-1])
        if plan.layout.lengths.size and plan.mission.fold.method != "paper":
            drawn.append(folder / f"{name}-swing.png")
            # that plan is neither shaped nor slowed yet
            plot_shaping(plan, make_plan(plan.mission), drawn[-1])
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
