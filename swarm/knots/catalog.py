"""From a knot's name or code to the diagram and the smallest grid diagram to fold it from."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from swarm.knots.connected_sums import Factor, name_of_sum
from swarm.knots.diagram import Diagram, diagram_of_pd, diagrams_of_dt, diagrams_of_gauss
from swarm.knots.gauss import KnotError, SignedGauss
from swarm.knots.grid import Grid, OpenGrid, grid_of_columns, openings, stabilised
from swarm.knots.grid import mirrored as mirrored_grid
from swarm.knots.grid_drawing import UNKNOT, grid_of_diagram
from swarm.knots.grid_reduction import smallest_grid
from swarm.knots.grid_search import random_grids
from swarm.knots.group_representations import sum_diagram
from swarm.knots.invariants import Identification, identify_diagram
from swarm.knots.names import ParsedName, parse_name, torus_grid
from swarm.knots.simplify import simplified
from swarm.knots.table import knot_table, prime_knot

__all__ = ["KnotChoice", "choose_knot", "lookup_knot", "other_grids", "table_names"]


@dataclass(frozen=True)
class KnotChoice:
    """The knot to tie: what it is, and the diagrams it is tied from.

    ``name`` is KnotInfo's, a sum's or "unknown", as for identification. ``chirality`` is "left",
    "right", or "none" for a knot that is its own mirror image. ``gauss`` is the Gauss code of
    ``diagram`` in the paper's notation, as it was given if it was. ``grid`` is a grid diagram of
    the knot, of minimal size where that is known. ``warnings`` are for the user. ``title`` is what
    to call the knot where ``name`` is "unknown", such as "torus(3,7)".
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
    """Names of all prime knots of the table, in its order."""
    return tuple(knot_table())


def lookup_knot(name: str) -> KnotChoice:
    """The knot of a name, right-handed where it is chiral and the name does not say left."""
    wanted = parse_name(name)
    return _of_name(wanted, wanted.chirality or "right")


def choose_knot(
    *,
    name: str | None = None,
    gauss: str | None = None,
    dt: Sequence[int] | None = None,
    pd: Sequence[Sequence[int]] | None = None,
    grid: Grid | Sequence[Sequence[int]] | None = None,
    chirality: str | None = None,
) -> KnotChoice:
    """The knot that exactly one of a name, a Gauss, DT or PD code, or a grid diagram describes.

    ``chirality`` is "left", "right", "either" or None. It may be left out only where the knot is
    its own mirror image, or where the description says which hand it means (a name such as m3_1,
    a code with signs, a PD code, a grid). "either" means that hand, or right where none is said.
    A code or grid of the other hand than asked for is mirrored, with a warning; such a name is
    refused.

    Raises KnotError for a wrong code or name, a link, or a hand or summand that is left open.
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


def _hand(is_chiral: bool, known: str | None, asked: str | None, what: str) -> str:
    """The hand to tie: "left", "right" or "none". Raises KnotError where it is left open."""
    if not is_chiral:
        return "none"
    if asked in {"left", "right"}:
        return str(asked)
    if known is not None:
        return known
    if asked == "either":
        return "right"
    raise KnotError(
        f"{what} is chiral and the description fits both its mirror images: "
        "say chirality: left, right or either"
    )


def _of_name(wanted: ParsedName, asked: str | None) -> KnotChoice:
    own = wanted.chirality
    if own and asked in {"left", "right"} and asked != own:
        raise KnotError(f'"{wanted.text}" is {own}-handed, but chirality says {asked}')
    if wanted.factors is not None:
        name, right = name_of_sum(wanted.factors)
        hand = _hand(right != "none", own, asked, name)
        factors = wanted.factors if hand in {right, "none"} else _mirror(wanted.factors)
        return _of_factors(factors, ())
    shape = torus_grid(*wanted.torus)
    known = identify_diagram(Diagram(shape.code))
    if known.name in knot_table():
        return _of_name(parse_name(known.name), own or asked)
    name = "torus({},{})".format(*wanted.torus)
    hand = _hand(is_chiral=True, known=own, asked=asked, what=name)
    if hand == "left":
        shape = mirrored_grid(shape)
    diagram = simplified(Diagram(shape.code))
    crossings = min(p * (q - 1) for p, q in (wanted.torus, wanted.torus[::-1]))
    grid = smallest_grid(shape, target=shape.size)
    warning = f"{name} is not in the table: its knot type can only be told by its crossing code"
    return KnotChoice(
        "unknown", hand, diagram.code.text(), diagram, grid, crossings, (warning,), title=name
    )


def _mirror(factors: tuple[Factor, ...]) -> tuple[Factor, ...]:
    return tuple((name, -hand) for name, hand in factors)


@lru_cache(maxsize=64)
def _of_factors(factors: tuple[Factor, ...], warnings: tuple[str, ...]) -> KnotChoice:
    """A knot of the table, or a sum of such, with these hands."""
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
    """The table's grid diagram of a prime knot; of a sum, one from a search.

    The arc index of a sum is the sum of its summands' less 2 for every further one (Cromwell
    1995), so the search knows when it is done.
    """
    grids = [
        mirrored_grid(prime_knot(name).grid) if hand < 0 else prime_knot(name).grid
        for name, hand in factors
    ]
    if len(grids) == 1:
        return grids[0]
    target = sum(grid.size for grid in grids) - 2 * (len(grids) - 1)
    return smallest_grid(grid_of_diagram(sum_diagram(factors)), target=target)


def _of_diagrams(
    diagrams: tuple[Diagram, ...], asked: str | None, shape: Grid | None
) -> KnotChoice:
    """The knot of a code: of one diagram, or of all those that the code can mean.

    A grid diagram that was given is kept, mirrored if need be; otherwise the table's is taken.
    """
    found = [(diagram, identify_diagram(diagram)) for diagram in diagrams]
    kinds = {known.name for _, known in found}
    if len(kinds) > 1:
        raise KnotError(
            f"the code can mean any of {', '.join(sorted(kinds))}: give crossing signs or a name"
        )
    known = found[0][1]
    hands = {one.chirality for _, one in found}
    own = hands.pop() if len(hands) == 1 else None
    hand = _hand(own != "none", own, asked, known.name if known.known else "this knot")
    match = [diagram for diagram, one in found if one.chirality == hand]
    diagram = match[0] if match else found[0][0].mirrored()
    if shape is not None and not match:
        shape = mirrored_grid(shape)
    choice = _best_known(known, hand, diagram, shape)
    warnings = list(choice.warnings)
    if not match:
        warnings.append(f"what was given is {own}-handed: its mirror image is tied, as asked for")
    if not known.known and hand == "none" and len(found) > 1:
        warnings.append(
            "its Jones polynomial does not tell its mirror images apart: the hand is open"
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
    known: Identification, hand: str, diagram: Diagram, shape: Grid | None
) -> KnotChoice:
    """What is known of an identified knot without its code; a search where that is nothing."""
    if known.known:
        wanted = parse_name(known.name)
        return _of_name(replace(wanted, chirality=None), hand if hand != "none" else None)
    small = smallest_grid(grid_of_diagram(diagram) if shape is None else shape)
    warning = (
        "this knot is not in the table of knots to ten crossings (at most "
        f"{known.crossings} crossings, determinant {known.invariants['determinant']})"
    )
    return KnotChoice(
        "unknown", hand, diagram.code.text(), diagram, small, known.crossings, (warning,)
    )


def other_grids(choice: KnotChoice, *, larger: int = 0, seed: int = 1) -> Iterator[Grid]:
    """Other grid diagrams of the same knot that can be opened, without end, each one new.

    They have the size of ``choice.grid`` plus ``larger``. Deterministic for a seed.
    """
    shape = choice.grid
    for step in range(larger):
        shape = stabilised(shape, 1 + step % shape.size, high=True, right=True, above=True)
    seen = {choice.grid}
    for grid in random_grids(shape, seed=seed):
        if grid not in seen and openings(grid, limit=1):
            seen.add(grid)
            yield grid
