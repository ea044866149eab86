"""The table of knots, made from Conway's notation: ``python -m swarm.knot_table`` writes it.

The names and Conway notations in ``conway.txt`` are those of Rolfsen's table (Conway 1970, Rolfsen
1976) without the second knot of the Perko pair, numbered as in KnotInfo. The diagrams, chiralities,
polynomials and grid diagrams are computed here.

Conway's notation (Conway 1970, "An enumeration of knots and links"): a tangle is a part of a
diagram with four ends at its corners. The tangle n is a row of n crossings; ``a b`` is a reflected
in its falling diagonal, followed by b; ``a,b,c`` stands for ``a 0 + b 0 + c 0``. Tangles may
replace the vertices of a basic polyhedron: ``6*`` (usually omitted), ``8*``, ``9*`` and ``10*``.
"""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from swarm import knots
from swarm.knots.diagram import Diagram, diagram_of_pd, diagrams_of_dt, simplified
from swarm.knots.gauss import KnotError
from swarm.knots.grid_search import grid_of_diagram, smallest_grid
from swarm.knots.invariants import alexander_polynomial, chirality_sign, jones_polynomial
from swarm.knots.names import table_order
from swarm.knots.table import Laurent, TableKnot

Ends = tuple[int, int, int, int]
"""Edges at the corners: north-west, north-east, south-east, south-west."""


@dataclass(frozen=True)
class Tangle:
    """Crossings with the edges at their corners, and whether the rising strand passes over.

    ``glue`` lists pairs of identified edges; ``ends`` are the edges at the tangle's own corners.
    """

    crossings: tuple[tuple[Ends, bool], ...]
    glue: tuple[tuple[int, int], ...]
    ends: Ends


class _Edges:
    """A source of unused edge numbers."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)

    def new(self) -> int:
        return next(self._numbers)

    def integer(self, number: int) -> Tangle:
        """Return a row of crossings; 0 is two parallel strands from left to right."""
        if number == 0:
            top, bottom = self.new(), self.new()
            return Tangle((), (), (top, top, bottom, bottom))
        ends = (self.new(), self.new(), self.new(), self.new())
        result = crossing = Tangle(((ends, number > 0),), (), ends)
        for _ in range(abs(number) - 1):
            ends = (self.new(), self.new(), self.new(), self.new())
            crossing = Tangle(((ends, number > 0),), (), ends)
            result = tangle_sum(result, crossing)
        return result


def tangle_sum(left: Tangle, right: Tangle) -> Tangle:
    """Return two tangles side by side."""
    return Tangle(
        left.crossings + right.crossings,
        (
            *left.glue,
            *right.glue,
            (left.ends[1], right.ends[0]),
            (left.ends[2], right.ends[3]),
        ),
        (left.ends[0], right.ends[1], right.ends[2], left.ends[3]),
    )


def reflect(tangle: Tangle) -> Tangle:
    """Return the tangle reflected in the diagonal from north-west to south-east."""

    def turn(ends: Ends) -> Ends:
        return (ends[0], ends[3], ends[2], ends[1])

    crossings = tuple((turn(ends), rising) for ends, rising in tangle.crossings)
    return Tangle(crossings, tangle.glue, turn(tangle.ends))


def rotate(tangle: Tangle) -> Tangle:
    """Return the tangle rotated by 90°: its north-east end becomes its north-west end."""
    nw, ne, se, sw = tangle.ends
    return Tangle(tangle.crossings, tangle.glue, (ne, se, sw, nw))


def negate(tangle: Tangle) -> Tangle:
    """Return the tangle with every crossing changed."""
    crossings = tuple((ends, not rising) for ends, rising in tangle.crossings)
    return Tangle(crossings, tangle.glue, tangle.ends)


def tangle_product(left: Tangle, right: Tangle) -> Tangle:
    """Return Conway's product ``a b``."""
    return tangle_sum(reflect(left), right)


def diagram_of_conway(notation: str) -> Diagram:
    """Return a diagram of a Conway notation. Raises KnotError for an invalid notation."""
    edges = _Edges()
    text = notation.replace(" ", "")
    if "*" in text or "." in text or ":" in text:
        return _polyhedral(text, edges)
    tangle = _tangle(text, edges)
    ends = tangle.ends
    return _closed([tangle], [(ends[0], ends[1]), (ends[3], ends[2])])


def _closed(tangles: Sequence[Tangle], joints: Sequence[tuple[int, int]]) -> Diagram:
    """Return the diagram of tangles whose ends are joined in pairs."""
    parent: dict[int, int] = {}

    def root(edge: int) -> int:
        while edge in parent:
            edge = parent[edge]
        return edge

    for first, second in [*joints, *(pair for tangle in tangles for pair in tangle.glue)]:
        if root(first) != root(second):
            parent[root(first)] = root(second)
    pd = []
    for (nw, ne, se, sw), rising in (item for tangle in tangles for item in tangle.crossings):
        # Counterclockwise from an end of the lower strand.
        ring = (nw, sw, se, ne) if rising else (sw, se, ne, nw)
        pd.append(tuple(root(edge) for edge in ring))
    return diagram_of_pd(pd)


_SIGNS = re.compile(r"[+-]*$")


def _tangle(text: str, edges: _Edges) -> Tangle:
    """Return an algebraic tangle: ``22``, ``3,21,2-``, ``(3,2)(21,2)``."""
    parts = _split(text, ",")
    if len(parts) > 1:
        tail = _SIGNS.search(parts[-1])
        signs = tail[0] if tail else ""
        parts[-1] = parts[-1][: len(parts[-1]) - len(signs)]
        result = reflect(_tangle(parts[0], edges))
        for part in parts[1:]:
            result = tangle_sum(result, reflect(_tangle(part, edges)))
        extra = signs.count("+") - signs.count("-")
        return tangle_sum(result, edges.integer(extra)) if extra else result
    if text.startswith("-"):
        return negate(_tangle(text[1:], edges))
    factors = re.findall(r"-?\([^()]*\)|-?\d", text)
    if "".join(factors) != text or not factors:
        raise KnotError(f'not a tangle in Conway\'s notation: "{text}"')
    result = _factor(factors[0], edges)
    for factor in factors[1:]:
        result = tangle_product(result, _factor(factor, edges))
    return result


def _factor(text: str, edges: _Edges) -> Tangle:
    if text.startswith("-("):
        return negate(_tangle(text[2:-1], edges))
    if text.startswith("("):
        return _tangle(text[1:-1], edges)
    return edges.integer(int(text))


def _split(text: str, mark: str) -> list[str]:
    """Return the parts of a text between marks outside brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == mark and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


Joint = tuple[tuple[int, int], tuple[int, int]]
_NW, _NE, _SE, _SW = range(4)


@dataclass(frozen=True)
class _Polyhedron:
    """A basic polyhedron: the joined corners of its vertices, and the orientation of tangles.

    ``order`` are the vertices in the order of the notation. At the vertices in
    ``rotated`` a tangle is rotated by 90°, so that crossings alternate; before that, it is
    reflected at those in ``flipped`` (found from the known polynomials of the notations).
    """

    order: tuple[int, ...]
    joints: tuple[Joint, ...]
    rotated: frozenset[int]
    flipped: frozenset[int]


def _braided(order: Sequence[int], flipped: Sequence[int]) -> _Polyhedron:
    """Return the polyhedron of a closed three-strand braid, crossing in turn above and below."""
    joints: list[Joint] = []
    last: list[tuple[int, int] | None] = [None] * 3
    first: list[tuple[int, int]] = [(-1, 0)] * 3
    for vertex in range(len(order)):
        upper = vertex % 2
        for strand, corner in ((upper, _NW), (upper + 1, _SW)):
            before = last[strand]
            if before is None:
                first[strand] = (vertex, corner)
            else:
                joints.append((before, (vertex, corner)))
        last[upper], last[upper + 1] = (vertex, _NE), (vertex, _SE)
    joints += [(end, start) for end, start in zip(last, first, strict=True) if end is not None]
    rotated = frozenset(range(1, len(order), 2))
    return _Polyhedron(tuple(order), tuple(joints), rotated, frozenset(flipped))


def _prismatic() -> _Polyhedron:
    """Return 9*: a vertex per edge of a triangular prism: outer 0–2, upright 3–5, inner 6–8."""
    joints: list[Joint] = []
    for k in range(3):
        following = (k + 1) % 3
        outer, upright, inner = k, 3 + k, 6 + k
        joints += [
            ((outer, _NE), (following, _NW)),
            ((inner, _SE), (6 + following, _SW)),
            ((outer, _SW), (upright, _NE)),
            ((outer, _SE), (3 + following, _NW)),
            ((inner, _NW), (upright, _SE)),
            ((inner, _NE), (3 + following, _SW)),
        ]
    order = (0, 3, 1, 4, 2, 5, 6, 7, 8)
    return _Polyhedron(order, tuple(joints), frozenset((3, 4, 5)), frozenset((3, 4, 5)))


_POLYHEDRA = {
    "6*": _braided(range(6), (1, 3, 5)),
    "6**": _braided((0, 1, 3, 4, 2, 5), (1, 4)),
    "8*": _braided(range(8), (1, 3, 5, 7)),
    "9*": _prismatic(),
    "10*": _braided(range(10), ()),
}


def _polyhedral(text: str, edges: _Edges) -> Diagram:
    """Return the diagram of tangles in a polyhedron, such as ``8*2:.20``.

    A missing tangle is 1; ``:`` stands for ``.1.``.

    Without the name of a polyhedron it is 6*, or, with a leading dot, Conway's other lettering 6**.
    """
    name, star, rest = text.rpartition("*")
    if not star:
        name, rest = ("6*", rest[1:]) if rest.startswith(".") else ("6", rest)
    shape = _POLYHEDRA[name + "*"]
    written = [part or "1" for part in rest.replace(":", ".1.").split(".")]
    written += ["1"] * (len(shape.order) - len(written))
    tangles: dict[int, Tangle] = {}
    for vertex, part in zip(shape.order, written, strict=True):
        tangle = _tangle(part, edges)
        if vertex in shape.flipped:
            tangle = reflect(tangle)
        tangles[vertex] = rotate(tangle) if vertex in shape.rotated else tangle
    joints = [
        (tangles[first].ends[corner], tangles[second].ends[other])
        for (first, corner), (second, other) in shape.joints
    ]
    return _closed([tangles[k] for k in sorted(tangles)], joints)


AMPHICHIRAL = frozenset(
    [
        "4_1",
        "6_3",
        "8_3",
        "8_9",
        "8_12",
        "8_17",
        "8_18",
        "10_17",
        "10_33",
        "10_37",
        "10_43",
        "10_45",
        "10_79",
        "10_81",
        "10_88",
        "10_99",
        "10_109",
        "10_115",
        "10_118",
        "10_123",
    ]
)
"""The prime knots to ten crossings that equal their mirror images."""


MOVES = 400_000
"""Attempted moves for a knot with an unknown arc index."""


def tabulate_knot(
    name: str, notation: str, *, moves: int = MOVES, starts: int = 24, steps: int = 400
) -> TableKnot:
    """Return the table's entry of a knot from its Conway notation."""
    chiral = name not in AMPHICHIRAL
    drawing = simplified(diagram_of_conway(notation), kicks=500)
    if drawing.crossings != table_order(name)[0]:
        raise RuntimeError(f"{name} has {drawing.crossings} crossings")
    dt = drawing.dt()
    diagram = _right(diagrams_of_dt(dt), chiral)
    # The arc index of an alternating knot is known (Bae and Park 2000).
    target = drawing.crossings + 2 if drawing.alternating else 2
    grid = smallest_grid(
        grid_of_diagram(diagram),
        target=target,
        starts=starts,
        steps=steps,
        moves=moves,
        fewest=drawing.crossings,
    )
    return TableKnot(
        name=name,
        chiral=chiral,
        dt=dt,
        first_sign=diagram.code.passes[0][2],
        jones=tuple(jones_polynomial(diagram).items()),
        alexander=tuple(alexander_polynomial(diagram).items()),
        grid=grid,
    )


def _right(pair: tuple[Diagram, ...], chiral: bool) -> Diagram:
    """Return the right-handed diagram of a mirror pair; the first where both are possible."""
    if chiral:
        for diagram in pair:
            if chirality_sign(jones_polynomial(diagram)) > 0:
                return diagram
    return pair[0]


def table_line(knot: TableKnot) -> str:
    """Return the knot as a line of the table's file."""
    return "\t".join(
        (
            knot.name,
            "chiral" if knot.chiral else "amphichiral",
            " ".join(map(str, knot.dt)),
            "+" if knot.first_sign > 0 else "-",
            _written(knot.jones),
            _written(knot.alexander),
            " ".join(f"{low}-{high}" for low, high in knot.grid.columns),
        )
    )


def _written(polynomial: Laurent) -> str:
    coefficients = dict(polynomial)
    low, high = min(coefficients), max(coefficients)
    return f"{low}:" + ",".join(str(coefficients.get(k, 0)) for k in range(low, high + 1))


def main() -> None:
    """Write the table to the package that reads it."""
    text = resources.files("swarm.knot_table").joinpath("conway.txt").read_text(encoding="utf-8")
    lines = []
    for entry in text.splitlines():
        name, notation = entry.split()
        lines.append(table_line(tabulate_knot(name, notation)))
    target = Path(knots.__file__).with_name("table.txt")
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")
