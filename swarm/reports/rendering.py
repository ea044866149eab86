"""HTML pages from the Jinja2 templates of this package; a page needs no network."""

import base64
import io
import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from swarm.reports.formatting import clock, metres, number, seconds
from swarm.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure as a ``data:`` URI, with a description for screen readers.

    A ``wide`` picture fills the page's width.
    """

    uri: str
    description: str
    wide: bool = False


def picture(figure: "Figure", description: str, *, wide: bool = False) -> Picture:
    """Return a figure as a PNG that is embedded in the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return Picture(f"data:image/png;base64,{data}", description, wide)


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
    environment.filters |= {
        "clock": clock,
        "metres": metres,
        "number": number,
        "seconds": seconds,
    }
    environment.tests["finite"] = math.isfinite
    environment.globals |= {"version": __version__, "static": _static}
    return environment


def _static(name: str) -> str:
    """Return a script or a style of this package, for its element in the page."""
    return files("swarm.reports").joinpath("static", name).read_text(encoding="utf-8")
