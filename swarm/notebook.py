"""Objects in notebooks: a title and a table of figures, as HTML."""

from collections.abc import Iterable
from html import escape


def table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return HTML with a bold title and rows of (name, figure); all text is escaped."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(figure)}</td></tr>'
        for name, figure in rows
    )
    return f"<div><strong>{escape(title)}</strong><table>{cells}</table></div>"
