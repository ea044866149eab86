"""Small pieces of HTML: everything that is put in is escaped, nothing is fetched from anywhere."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


STYLE = """
:root { color-scheme: light; --ink: #1d2430; --dim: #667085; --line: #d9dde5; --good: #18794e;
  --bad: #b42318; --warn: #b54708; --soft: #f4f6f9; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1rem 3rem; max-width: 62rem; color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .3rem; }
h2 { font-size: 1.1rem; margin: 2rem 0 .6rem; border-bottom: 1px solid var(--line); }
p { margin: .4rem 0; }
.dim { color: var(--dim); }
.small { font-size: .8rem; overflow-wrap: anywhere; }
.verdict { padding: .7rem .9rem; border-radius: .5rem; border-left: .35rem solid; margin: 1rem 0;
  background: var(--soft); font-weight: 600; overflow-wrap: anywhere; }
.verdict.good { border-color: var(--good); color: var(--good); }
.verdict.bad { border-color: var(--bad); color: var(--bad); }
.verdict.warn { border-color: var(--warn); color: var(--warn); }
.figures { display: grid; gap: .6rem;
  grid-template-columns: repeat(auto-fit, minmax(7.2rem, 1fr)); }
.figure { background: var(--soft); border-radius: .5rem; padding: .5rem .7rem; }
.figure b { display: block; font-size: 1.25rem; font-variant-numeric: tabular-nums; }
.figure span { color: var(--dim); font-size: .85rem; }
.pictures { display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 19rem), 1fr)); }
.wide { grid-column: 1 / -1; }
figure { margin: 0; break-inside: avoid; }
figure img { width: 100%; height: auto; display: block; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .3rem .7rem .3rem 0; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { color: var(--dim); font-weight: 500; white-space: nowrap; }
td.number, th.number { text-align: right; white-space: nowrap; }
.good { color: var(--good); } .bad { color: var(--bad); font-weight: 600; }
.warn { color: var(--warn); }
pre { columns: 2 18rem; background: var(--soft); padding: .7rem; border-radius: .5rem;
  overflow-x: auto; font-size: .8rem; }
footer { margin-top: 2.5rem; color: var(--dim); font-size: .85rem; }
@media (max-width: 30rem) { table { font-size: .76rem; line-height: 1.4; }
  th, td { padding-right: .35rem; } th, th.number { white-space: normal; }
  .range { display: block; } }
@media print { body { max-width: none; padding: 0; font-size: 11px; }
  h2 { break-after: avoid; } tr { break-inside: avoid; } .scroll { overflow: visible; }
  pre { white-space: pre-wrap; } }
"""


class Html(str):
    """Text that is HTML already and must not be escaped again."""

    __slots__ = ()


def text(value: object) -> Html:
    """Return a value as HTML: as it is when it is HTML, escaped otherwise."""
    return value if isinstance(value, Html) else Html(escape(str(value)))


def tag(name: str, *content: object, kind: str = "") -> Html:
    """Return an element around contents, with a class where ``kind`` names one."""
    attribute = f' class="{escape(kind)}"' if kind else ""
    return Html(f"<{name}{attribute}>{''.join(map(text, content))}</{name}>")


def section(title: str, *content: object) -> Html:
    """Return a titled section; nothing where all its contents are empty."""
    if not any(content):
        return Html("")
    return tag("section", tag("h2", title), *content)


def table(
    head: Sequence[str], rows: Iterable[Sequence[object]], numbers: frozenset[int] = frozenset()
) -> Html:
    """Return a table that scrolls sideways where it does not fit; nothing without rows.

    The columns in ``numbers`` are aligned to the right.
    """

    def row(cell: str, values: Sequence[object]) -> Html:
        kinds = ("number" if i in numbers else "" for i in range(len(values)))
        return tag("tr", *(tag(cell, v, kind=k) for v, k in zip(values, kinds, strict=True)))

    body = [row("td", values) for values in rows]
    if not body:
        return Html("")
    inner = tag("table", tag("thead", row("th", head)), tag("tbody", *body))
    return tag("div", inner, kind="scroll")


def key_figures(pairs: Iterable[tuple[str, object]]) -> Html:
    """Return figures with their names below, side by side."""
    cards = [tag("div", tag("b", value), tag("span", name), kind="figure") for name, value in pairs]
    return tag("div", *cards, kind="figures")


def picture(figure: "Figure", words: str, *, wide: bool = False) -> Html:
    """Return a figure embedded in the page; ``words`` describe it to those who cannot see it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    image = Html(f'<img src="data:image/png;base64,{data}" alt="{escape(words)}">')
    return tag("figure", image, kind="wide" if wide else "")


def pictures(*figures: Html) -> Html:
    """Return pictures side by side where there is room."""
    return tag("div", *figures, kind="pictures") if figures else Html("")


def page(title: str, *content: object) -> str:
    """Return a whole page that needs nothing but itself."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>"
        f"<body>{''.join(map(text, content))}</body></html>\n"
    )
