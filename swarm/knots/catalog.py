"""The catalogue: a knot's name or code → its diagram and the smallest grid diagram."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from swarm.knots.diagram import (
    Diagram,
    diagram_of_pd,
    diagrams_of_dt,
    diagrams_of_gauss,
    simplified,
)
from swarm.knots.gauss import KnotError, SignedGauss
from swarm.knots.grid import Grid, OpenGrid, grid_of_columns, openings
from swarm.knots.grid import mirrored as mirrored_grid
from swarm.knots.grid_search import UNKNOT, grid_of_diagram, smallest_grid
from swarm.knots.invariants import Identification, identify_diagram, sum_diagram
from swarm.knots.names import Factor, ParsedName, name_of_sum, parse_name, torus_grid
from swarm.knots.table import knot_table, prime_knot


@dataclass(frozen=True)
class KnotChoice:
    """The knot to tie, and its diagrams.

    ``name`` is KnotInfo's name, the name of a sum, or "unknown", as for identification.
    ``chirality`` is "left", "right", or "none" for a knot that equals its mirror image. ``gauss``
    is the Gauss code of ``diagram`` in the paper's notation; a given code is kept. ``grid`` is a
    grid diagram of the knot, of minimal size where that size is known. ``warnings`` are for the
    user. ``title`` names the knot where ``name`` is "unknown", such as "torus(3,7)".
    """

    name: str
    chirality: str
    gauss: str
    diagram: Diagram
    grid: Grid
    crossings: int
    warnings: tuple[str, ...] = ()
    title: str = ""

    @property
    def vehicles(self) -> int:
        """2N − 1: one vehicle per corner of the opened grid diagram."""
        return 2 * self.grid.size - 1

    @property
    def opening(self) -> OpenGrid:
        """The best opening of the grid diagram."""
        return openings(self.grid, limit=1)[0]


def table_names() -> tuple[str, ...]:
    """Return the names of all prime knots of the table, in its order."""
    return tuple(knot_table())


def lookup_knot(name: str) -> KnotChoice:
    """Return the knot of a name; a chiral knot is right-handed unless the name says left."""
    parsed = parse_name(name)
    return _of_name(parsed, parsed.chirality or "right")


def choose_knot(
    *,
    name: str | None = None,
    gauss: str | None = None,
    dt: Sequence[int] | None = None,
    pd: Sequence[Sequence[int]] | None = None,
    grid: Grid | Sequence[Sequence[int]] | None = None,
    chirality: str | None = None,
) -> KnotChoice:
    """Return the knot of exactly one of: name, Gauss code, DT code, PD code, grid diagram.

    ``chirality`` is "left", "right", "either" or None. None is valid only where the knot equals its
    mirror image, or where the description determines the chirality (a name such as m3_1, a code
    with signs, a PD code, a grid). "either" means the chirality of the description, or right where
    the description has none. A code or grid of the opposite chirality is mirrored, with a warning;
    a name of the opposite chirality is an error.

    Raises KnotError for an invalid code or name, a link, or an undetermined chirality or summand.
    """
    if chirality not in {None, "left", "right", "either"}:
        raise KnotError(f'chirality: expected left, right or either, got "{chirality}"')
    given = [
        key
        for key, value in (("name", name), ("gauss", gauss), ("dt", dt), ("pd", pd), ("grid", grid))
        if value is not None
    ]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise KnotError(f"expected one of name, gauss, dt, pd or grid, got {got}")
    if name is not None:
        return _of_name(parse_name(name), chirality)
    if grid is not None:
        shape = grid if isinstance(grid, Grid) else grid_of_columns(grid)
        return _of_diagrams((Diagram(shape.code),), chirality, shape)
    if pd is not None:
        return _of_diagrams((diagram_of_pd(pd),), chirality, None)
    diagrams = diagrams_of_gauss(gauss) if gauss is not None else diagrams_of_dt(dt or ())
    return _of_diagrams(diagrams, chirality, None)


def _resolve_chirality(is_chiral: bool, known: str | None, required: str | None, knot: str) -> str:
    """Return "left", "right" or "none". Raises KnotError where the chirality is undetermined."""
    if not is_chiral:
        return "none"
    if required in {"left", "right"}:
        return str(required)
    if known is not None:
        return known
    if required == "either":
        return "right"
    raise KnotError(
        f"{knot} is chiral and the description fits both mirror images: "
        "set chirality: left, right or either"
    )


def _of_name(parsed: ParsedName, required: str | None) -> KnotChoice:
    own = parsed.chirality
    if own and required in {"left", "right"} and required != own:
        raise KnotError(f'"{parsed.text}" is {own}-handed, but chirality says {required}')
    if parsed.factors is not None:
        name, right = name_of_sum(parsed.factors)
        chirality = _resolve_chirality(right != "none", own, required, name)
        factors = parsed.factors if chirality in {right, "none"} else _mirror(parsed.factors)
        return _of_factors(factors, ())
    shape = torus_grid(*parsed.torus)
    crossings = min(p * (q - 1) for p, q in (parsed.torus, parsed.torus[::-1]))
    # The table has every knot to some number of crossings: a larger one is not searched in it.
    if crossings <= max(knot.crossings for knot in knot_table().values()):
        known = identify_diagram(Diagram(shape.code))
        if known.name in knot_table():
            return _of_name(parse_name(known.name), own or required)
    name = "torus({},{})".format(*parsed.torus)
    chirality = _resolve_chirality(is_chiral=True, known=own, required=required, knot=name)
    if chirality == "left":
        shape = mirrored_grid(shape)
    diagram = simplified(Diagram(shape.code))
    grid = smallest_grid(shape, target=shape.size)
    warning = f"{name} is not in the table: it can be identified only by its Gauss code"
    return KnotChoice(
        "unknown", chirality, diagram.code.text(), diagram, grid, crossings, (warning,), title=name
    )


def _mirror(factors: tuple[Factor, ...]) -> tuple[Factor, ...]:
    return tuple((name, -sign) for name, sign in factors)


@lru_cache(maxsize=64)
def _of_factors(factors: tuple[Factor, ...], warnings: tuple[str, ...]) -> KnotChoice:
    """Return a knot of the table or a sum of table knots, with the given chiralities."""
    name, chirality = name_of_sum(factors)
    if not factors:
        return KnotChoice(
            "0_1",
            "none",
            "",
            Diagram(SignedGauss((), closed=True)),
            UNKNOT,
            0,
            (*warnings, "this is the unknot: the cable will not be knotted"),
        )
    diagram = sum_diagram(factors)
    shape = factor_grid(factors)
    crossings = sum(prime_knot(part).crossings for part, _ in factors)
    return KnotChoice(name, chirality, diagram.code.text(), diagram, shape, crossings, warnings)


def factor_grid(factors: tuple[Factor, ...]) -> Grid:
    """Return the table's grid diagram of a prime knot; for a sum, the result of a search.

    The search stops at the arc index of the sum: the sum of the arc indices of its summands, less 2
    for every summand after the first (Cromwell 1995).
    """
    grids = [
        mirrored_grid(prime_knot(name).grid) if sign < 0 else prime_knot(name).grid
        for name, sign in factors
    ]
    if len(grids) == 1:
        return grids[0]
    target = sum(grid.size for grid in grids) - 2 * (len(grids) - 1)
    return smallest_grid(grid_of_diagram(sum_diagram(factors)), target=target)


def _of_diagrams(
    diagrams: tuple[Diagram, ...], required: str | None, shape: Grid | None
) -> KnotChoice:
    """Return the knot of a code: of one diagram, or of all diagrams that the code can mean.

    A given grid diagram is kept, mirrored if necessary; otherwise it is the table's.
    """
    identified = [(diagram, identify_diagram(diagram)) for diagram in diagrams]
    kinds = {known.name for _, known in identified}
    if len(kinds) > 1:
        raise KnotError(
            f"the code can mean any of {', '.join(sorted(kinds))}: give crossing signs or a name"
        )
    known = identified[0][1]
    chiralities = {identity.chirality for _, identity in identified}
    own = chiralities.pop() if len(chiralities) == 1 else None
    knot = known.name if known.known else "this knot"
    chirality = _resolve_chirality(own != "none", own, required, knot)
    match = [diagram for diagram, identity in identified if identity.chirality == chirality]
    diagram = match[0] if match else identified[0][0].mirrored()
    if shape is not None and not match:
        shape = mirrored_grid(shape)
    choice = _best_known(known, chirality, diagram, shape)
    warnings = list(choice.warnings)
    if not match:
        warnings.append(f"the given knot is {own}-handed: its mirror image is tied, as required")
    if not known.known and chirality == "none" and len(identified) > 1:
        warnings.append(
            "its Jones polynomial is that of its mirror image: its chirality is undetermined"
        )
    if shape is not None and shape.size > choice.grid.size:
        warnings.append(
            f"the grid given is kept; this knot has one of size {choice.grid.size}, "
            f"for {choice.vehicles} vehicles instead of {2 * shape.size - 1}"
        )
    return replace(
        choice,
        gauss=diagram.code.text(),
        diagram=diagram,
        grid=choice.grid if shape is None else shape,
        warnings=tuple(warnings),
    )


def _best_known(
    known: Identification, chirality: str, diagram: Diagram, shape: Grid | None
) -> KnotChoice:
    """Return the table's entry of an identified knot, or the result of a search."""
    if known.known:
        parsed = parse_name(known.name)
        return _of_name(replace(parsed, chirality=None), chirality if chirality != "none" else None)
    small = smallest_grid(grid_of_diagram(diagram) if shape is None else shape)
    warning = (
        "this knot is not in the table of knots to ten crossings (at most "
        f"{known.crossings} crossings, determinant {known.invariants['determinant']})"
    )
    return KnotChoice(
        "unknown", chirality, diagram.code.text(), diagram, small, known.crossings, (warning,)
    )
