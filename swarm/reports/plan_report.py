"""The page of a plan."""

import matplotlib as mpl
import numpy as np

from swarm.certification.assessment import Assessment
from swarm.certification.clearances import Moment
from swarm.certification.kinds import FIGURES
from swarm.planning import Plan
from swarm.reports import plots, scene
from swarm.reports.fold_labels import label_fold
from swarm.reports.motion_view import planned_motion
from swarm.reports.plan_details import BUDGET, IN_TABLES, budget_cells
from swarm.reports.rendering import Picture, picture, render
from swarm.reports.schedule_plots import schedule_figure
from swarm.reports.strand_distances import planned_strand_distances
from swarm.reports.verdicts import plan_verdict
from swarm.reports.wording import (
    knot_in_words,
    plan_figures,
    sorted_findings,
)


def plan_report(plan: Plan, assessment: Assessment) -> str:
    """Return the page of a plan: verdict, figures, pictures, distances, findings, tables."""
    return render(
        "plan.html.j2",
        mission=plan.mission,
        knot=knot_in_words(plan.knot.type, plan.knot.chirality),
        gauss_code=plan.knot.gauss,
        verdict=plan_verdict(plan, assessment),
        figures=plan_figures(plan, assessment),
        motion=planned_motion(plan, assessment),
        findings=[
            one
            for one in sorted_findings(assessment)
            if not (assessment.moments and one.check in IN_TABLES)
        ],
        tightest=[] if not assessment.moments else assessment.tightest,
        budget_head=["", *(name for name, _ in BUDGET)],
        budget=[budget_cells(row) for row in assessment.budget],
        neighbours=_tightest(assessment, "neighbouring segments"),
        clearances=[(FIGURES[name], one) for name, one in assessment.distances.items()],
        pictures=_pictures(plan, assessment),
        segments=_segments(plan),
        crossings=scene.crossings(plan.layout),
        phases=plan.phases,
        gates=plan.gates,
        notes=plan.notes,
        mission_json=plan.mission.model_dump_json(by_alias=True, exclude_none=True, indent=1),
    )


def _segments(plan: Plan) -> list[tuple[object, ...]]:
    """Return a row per segment: number, cable, chord, sag and lane, metres."""
    layout = plan.layout
    chords = np.linalg.norm(np.diff(scene.joined(layout.corners, layout.lengths), axis=0), axis=1)
    columns = zip(layout.lengths, chords, layout.sags, layout.lanes, strict=True)
    return [
        (number, *(f"{value:.2f}" for value in values)) for number, values in enumerate(columns, 1)
    ]


def _tightest(assessment: Assessment, check: str) -> Moment | None:
    """Return the tightest moment of one check; None where it has none."""
    moments = [moment for moment in assessment.moments if moment.check == check]
    return min(moments, key=lambda moment: moment.distance, default=None)


@mpl.rc_context(plots.STYLE)
def _pictures(plan: Plan, assessment: Assessment) -> list[Picture]:
    pictures = []
    if plan.knot.grid_columns:
        figure, axes = plots.new_axes()
        plots.draw_grid(axes, plan.knot, plan.layout)
        folded = plots.grid_places(plan.knot, plan.layout) is not None
        words = "numbered like the plan view" if folded else "which this layout does not follow"
        pictures.append(picture(figure, f"Grid diagram of the knot, {words}"))
    figure, axes = plots.new_axes()
    plots.draw_plan_view(axes, plan.layout)
    pictures.append(picture(figure, "The cable from above; under strands have gaps"))
    figure, axes = plots.new_axes((8.0, 3.8), projection="3d")
    plots.draw_fold(axes, plan.layout, zoom=1.35)
    label_fold(axes, plan.layout, plots.INK)
    pictures.append(picture(figure, "The folded cable in space", wide=True))
    if len(plan.layout.lengths) >= 3:
        figure, axes = plots.new_axes((8.0, 2.8))
        times, distance = planned_strand_distances(plan)
        required = plan.mission.clearance.cable
        title = "Smallest distance of strands that are not neighbours, planned"
        tightest = _tightest(assessment, "cable clearance")
        plots.draw_clearance(axes, times, distance, required, title, tightest)
        pictures.append(picture(figure, title, wide=True))
    schedule = schedule_figure(plan)
    pictures.append(picture(schedule, "Schedule and heights of the vehicles", wide=True))
    return pictures
