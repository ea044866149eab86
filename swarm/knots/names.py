"""Names of knots: KnotInfo's, common names, torus knots, connected sums and mirror images."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from swarm.errors import nearest
from swarm.knots.gauss import KnotError
from swarm.knots.grid import Grid
from swarm.knots.table import knot_table

Factor = tuple[str, int]
"""Name of a prime knot and its chirality: 1 right, −1 left, 0 where it equals its mirror image."""

CHIRALITIES = {1: "right", -1: "left", 0: "none"}


def table_order(name: str) -> tuple[int, int]:
    """Return the sort key of a table name such as 10_132."""
    crossings, number = name.split("_")
    return int(crossings), int(number)


def mirror_factors(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    """Return the mirror image of a sum."""
    return canonical_factors((name, -sign) for name, sign in factors)


def canonical_factors(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    """Return the prime factors of a sum in the order of the table, right-handed ones first."""
    return tuple(sorted(factors, key=lambda factor: (table_order(factor[0]), -factor[1])))


def name_of_sum(factors: Iterable[Factor]) -> tuple[str, str]:
    """Return name and chirality of a sum, such as ("3_1#m3_1", "none") or ("3_1#5_2", "left").

    Of a chiral sum and its mirror image, the right-handed one has the larger chirality (1 > −1) at
    the first summand that differs. The name marks its left-handed summands with m.
    """
    own = canonical_factors(factors)
    other = mirror_factors(own)
    right = max(own, other, key=lambda sums: [sign for _, sign in sums])
    chirality = "none" if own == other else CHIRALITIES[1 if own == right else -1]
    name = "#".join(f"m{name}" if sign < 0 else name for name, sign in right)
    return name or "0_1", chirality


COMMON_NAMES = {
    "unknot": "0_1",
    "overhand": "3_1",
    "trefoil": "3_1",
    "figure-eight": "4_1",
    "figure-8": "4_1",
    "figure-of-eight": "4_1",
    "figure-of-8": "4_1",
    "savoy": "4_1",
    "flemish": "4_1",
    "cinquefoil": "5_1",
    "solomon's seal": "5_1",
    "double overhand": "5_1",
    "three-twist": "5_2",
    "stevedore": "6_1",
    "miller institute": "6_2",
    "septafoil": "7_1",
    "endless": "7_4",
    "nonafoil": "9_1",
    "carrick mat": "8_18",
    "true lover's": "8_19",
    "true lovers": "8_19",
    "granny": "3_1#3_1",
    "square": "3_1#m3_1",
    "reef": "3_1#m3_1",
}
"""Common names, in lower case and without the word knot; spaces, hyphens, underscores are alike."""


def describe_knot(name: str, chirality: str) -> str:
    """Return a knot's name with its chirality: "3_1 right-handed", "4_1"; "no knot" without one."""
    hand = f" {chirality}-handed" if chirality in {"left", "right"} else ""
    return f"{name}{hand}" if name else "no knot"


@dataclass(frozen=True)
class ParsedName:
    """A parsed name: prime factors with their chiralities, or a torus knot (p, q).

    ``chirality`` is set where the name determines it; ``text`` is the name as written.
    """

    factors: tuple[Factor, ...] | None
    torus: tuple[int, int]
    chirality: str | None
    text: str


_LARGEST_TORUS = 125
"""Largest arc index p + q of a torus knot: 250 MAVLink system ids for 2 (p + q) − 1 vehicles."""

_TORUS = re.compile(r"(m?)(?:torus|t)\(?\s*(-?\d+)\s*[,\s]\s*(-?\d+)\s*\)?")
_TABLE = re.compile(r"(m?)(\d+)[_\-. ](\d+)")


def parse_name(text: str) -> ParsedName:
    """Return the parsed name of a knot. Raises KnotError for an unknown name."""
    plain = re.sub(r"\s+", " ", text.strip().lower().replace("’", "'"))
    plain = re.sub(r"[ -]?knot$", "", plain) if plain not in COMMON_NAMES else plain
    hand = None
    side = re.match(r"(left|right)(?:[- ]hand(?:ed)?)? (.*)", plain)
    if side:
        hand, plain = side[1], side[2]
    plain = _common(plain)
    torus = _TORUS.fullmatch(plain)
    if torus:
        return _torus(torus, hand, text)
    factors: list[Factor] = []
    marked_left = False
    for part in plain.split("#"):
        own, left = _factor(part.strip(), text)
        factors += own
        marked_left |= left
    chirality = name_of_sum(tuple(factors))[1]
    if chirality == "none":
        return ParsedName(tuple(factors), (0, 0), None, text)
    written = chirality if marked_left or chirality == "left" else None
    return ParsedName(tuple(factors), (0, 0), hand or written, text)


def _common(name: str) -> str:
    """Return the table's name of a common name, however its words are joined; others unchanged."""
    return _SPELLINGS.get(_joined(name), name)


def _joined(name: str) -> str:
    return re.sub(r"[ _'-]|knot$", "", name)


_SPELLINGS = {_joined(name): knot for name, knot in COMMON_NAMES.items()}
"""Common name without spaces, hyphens and underscores → name of the table."""


def _factor(part: str, text: str) -> tuple[list[Factor], bool]:
    """Return the prime factors of one summand, and whether it is written as a mirror image."""
    part = _common(part)
    mirror = part.startswith("m") and (part[1:] in COMMON_NAMES or _TABLE.fullmatch(part[1:]))
    if mirror:
        part = COMMON_NAMES.get(part[1:], part[1:])
    if part in {"0_1", "0-1"}:
        return [], False
    match = _TABLE.fullmatch(part)
    name = f"{match[2]}_{int(match[3])}" if match else ""
    if name not in knot_table():
        hint = nearest(part, COMMON_NAMES) or ";"  # a number without a knot is near to nothing
        if re.match(r"(dt|gauss)(code)?\W", text, re.IGNORECASE):
            hint = "; a code stands in a mission file, as knot: {dt: …} or {gauss: …};"
        raise KnotError(f'no knot is called "{text}" here{hint} `swarm knots` lists the names')
    hand = (-1 if mirror else 1) if knot_table()[name].chiral else 0
    return [(name, hand)], bool(mirror)


def _torus(match: re.Match[str], hand: str | None, text: str) -> ParsedName:
    p, q = int(match[2]), int(match[3])
    if math.gcd(p, q) != 1:
        raise KnotError(f"torus({p},{q}) is a link of {math.gcd(p, q)} components, not a knot")
    left = (p * q < 0) != bool(match[1])
    small, large = sorted((abs(p), abs(q)))
    if small <= 1:
        return ParsedName((), (0, 0), None, text)
    if small + large > _LARGEST_TORUS:
        raise KnotError(
            f"torus({p},{q}) needs {2 * (small + large) - 1} vehicles; there are at most "
            f"{2 * _LARGEST_TORUS - 1}"
        )
    return ParsedName(None, (small, large), hand or ("left" if left else None), text)


def torus_grid(p: int, q: int) -> Grid:
    """Return a grid of the right-handed torus knot, of its arc index p + q (Matsuda 2006)."""
    size = p + q
    pairs = (sorted((k, (k + p) % size)) for k in range(size))
    return Grid(tuple((low + 1, high + 1) for low, high in pairs)[::-1])
