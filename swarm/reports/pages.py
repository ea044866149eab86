"""HTML pages from the Jinja2 templates of this package; a page needs no network."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from swarm.certification.assessment import Assessment
from swarm.planning import Plan
from swarm.reports.formatting import plan_figures
from swarm.reports.motion_view import MotionView
from swarm.reports.result import Picture, Table, Verdict, findings_table
from swarm.version import __version__

Figures = Sequence[tuple[str, object]]
"""Key figures: name and value."""


@dataclass(frozen=True)
class Section:
    """A part of a page below its heading; one without content is left out.

    ``note`` stands above the content, pictures are in columns of at least the width ``least``.
    """

    heading: str
    tables: Sequence[Table] = ()
    note: str = ""
    figures: Figures = ()
    paragraphs: Sequence[str] = ()
    pictures: Sequence[Picture] = ()
    least: str = "19rem"
    listing: str = ""

    @property
    def empty(self) -> bool:
        """Whether it has nothing below its heading and its note."""
        rows = any(table.rows for table in self.tables)
        return not (rows or self.figures or self.paragraphs or self.pictures or self.listing)


def plan_section(plan: Plan, assessment: Assessment) -> Section:
    """Return the plan of a flight or of another result: key figures and findings, errors first."""
    findings = findings_table(assessment.findings, worst_first=True)
    return Section("The plan", [findings], figures=plan_figures(plan, assessment))


def page(
    kind: str,
    name: str,
    heading: str,
    verdict: Verdict,
    sections: Sequence[Section],
    *,
    about: Sequence[str] = (),
    figures: Figures = (),
    motion: MotionView | None = None,
    footer: str = "",
) -> str:
    """Return the page of a result of the mission ``name``.

    ``kind`` begins the title of the window, ``about`` are lines below the heading. Without a
    ``footer`` the page explains what is certified.
    """
    return render(
        "result.html.j2",
        kind=kind,
        name=name,
        heading=heading,
        about=about,
        verdict=verdict,
        figures=figures,
        motion=motion,
        sections=[section for section in sections if not section.empty],
        footer=footer,
    )


def render(template: str, **values: Any) -> str:
    """Return a page: the template with its values, which are escaped.

    Raises :class:`jinja2.UndefinedError` where the template uses a value that is not given.
    """
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("swarm.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"version": __version__, "static": _static}
    return environment


def _static(name: str) -> str:
    """Return a script or a style of this package, for its element in the page."""
    return files("swarm.reports").joinpath("static", name).read_text(encoding="utf-8")
