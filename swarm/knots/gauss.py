"""Signed Gauss codes, their notations, and the exact comparison of two codes.

The plan view of a cable has crossings. A walk along the cable passes each crossing twice, once over
and once under. A *signed Gauss code* lists these passes in order, with the sign of each crossing:
positive (over direction × under direction points up, right-handed) or negative. It determines a
closed or open diagram up to isotopy of the sphere.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from swarm.errors import InputError


class KnotError(InputError):
    """A code, grid, name or curve describes no knot, a link, or more than one knot."""


@dataclass(frozen=True)
class SignedGauss:
    """Passes ``(crossing, over, sign)`` in order along the cable; crossings numbered from 1.

    ``sign`` is +1 or −1. Crossings are numbered in order of their first pass.
    """

    passes: tuple[tuple[int, bool, int], ...]
    closed: bool = False

    @staticmethod
    def of(passes: Iterable[tuple[int, bool, int]], *, closed: bool) -> "SignedGauss":
        """Return the code of passes with any labels, renumbered in order of their first pass.

        Raises KnotError where a crossing is not passed exactly once over and once under.
        """
        listed = tuple(passes)
        check_labels([(label, over) for label, over, _ in listed])
        if any(sign not in {1, -1} for _, _, sign in listed):
            raise KnotError("every crossing's sign is +1 or −1")
        signs = {label: sign for label, _, sign in listed}
        if any(signs[label] != sign for label, _, sign in listed):
            raise KnotError("a crossing has the same sign at both of its passes")
        return _renumbered(listed, closed)

    @property
    def crossings(self) -> int:
        """Number of crossings."""
        return len(self.passes) // 2

    @property
    def writhe(self) -> int:
        """Sum of the crossing signs."""
        return sum(sign for _, _, sign in self.passes) // 2

    def mirrored(self) -> "SignedGauss":
        """Return the mirror image in a vertical mirror: same over and under, all signs changed."""
        return SignedGauss(tuple((k, over, -sign) for k, over, sign in self.passes), self.closed)

    def reversed(self) -> "SignedGauss":
        """Return the code from the other end; signs do not change."""
        return _renumbered(self.passes[::-1], self.closed)

    def rotated(self, start: int) -> "SignedGauss":
        """Return the same closed code from its pass number ``start`` on."""
        return _renumbered(self.passes[start:] + self.passes[:start], self.closed)

    def as_closed(self) -> "SignedGauss":
        """Return an open code closed without further crossings, or far above all strands."""
        return SignedGauss(self.passes, closed=True)

    def text(self) -> str:
        """Return over and under marks, as in the paper: ``1- 2+ 3- 1+ 2- 3+`` (+ passes over)."""
        return " ".join(f"{label}{'+' if over else '-'}" for label, over, _ in self.passes)

    def signed_text(self) -> str:
        """Return the code with signs, ``U1+ O2+ …``: O(ver) or U(nder), crossing, sign."""
        return " ".join(
            f"{'O' if over else 'U'}{label}{'+' if sign > 0 else '-'}"
            for label, over, sign in self.passes
        )


def _renumbered(passes: Sequence[tuple[int, bool, int]], closed: bool) -> SignedGauss:
    number: dict[int, int] = {}
    for label, _, _ in passes:
        number.setdefault(label, len(number) + 1)
    return SignedGauss(tuple((number[k], over, sign) for k, over, sign in passes), closed)


def same_code(first: SignedGauss, second: SignedGauss, *, reverse: bool = False) -> bool:
    """Return whether two codes describe the same diagram, up to the labels of crossings.

    Open codes must agree in order and direction from end to end, closed codes from some starting
    point. With ``reverse`` the second code may also run the other way.
    """
    if first.closed != second.closed or len(first.passes) != len(second.passes):
        return False
    ways = [second, second.reversed()] if reverse else [second]
    target = _renumbered(first.passes, first.closed).passes
    starts = range(max(1, len(second.passes))) if first.closed else range(1)
    return any(way.rotated(start).passes == target for way in ways for start in starts)


def check_labels(passes: Sequence[tuple[int, bool]]) -> None:
    """Raise KnotError with every crossing that is not passed once over and once under."""
    wrong = []
    overs = Counter(label for label, over in passes if over)
    unders = Counter(label for label, over in passes if not over)
    for label in sorted(overs.keys() | unders.keys()):
        over, under = overs[label], unders[label]
        if over + under != 2:
            times = "once" if over + under == 1 else f"{over + under} times"
            wrong.append(f"crossing {label} is passed {times} (expected twice)")
        elif over != 1:
            wrong.append(f"crossing {label} is passed twice {'over' if over else 'under'}")
    if wrong:
        raise KnotError("; ".join(wrong))


@dataclass(frozen=True)
class ParsedGauss:
    """A parsed Gauss code: passes, and crossing signs where the text has them."""

    passes: tuple[tuple[int, bool], ...]
    signs: tuple[int, ...] | None

    def signed(self) -> SignedGauss | None:
        """Return the signed code, or None where the text has no signs."""
        if self.signs is None:
            return None
        return SignedGauss.of(
            ((k, over, sign) for (k, over), sign in zip(self.passes, self.signs, strict=True)),
            closed=True,
        )


_PAPER = re.compile(r"(\d+)([+-])")
_SIGNED = re.compile(r"([OU])(\d+)([+-])", re.IGNORECASE)
_INTEGER = re.compile(r"([+-]?)(\d+)")
_LINK = re.compile(r"[|/;]|\)\s*,?\s*\(|\}\s*,?\s*\{|\]\s*,?\s*\[")


def parse_gauss(text: str) -> ParsedGauss:
    """Return the parsed Gauss code of a text in one of three notations.

    ``1- 2+ 3- 1+ 2- 3+`` is the paper's (+ passes over, − under); ``U1+ O2+ U3+ O1+ U2+ O3+`` also
    gives each crossing's sign; ``-1, 2, -3, 1, -2, 3`` is KnotInfo's (negative passes under).
    Raises KnotError for an invalid token or label, a second component, or an empty code.
    """
    if _LINK.search(text):
        parts = len([part for part in _LINK.split(text) if part.strip(" ,()[]{}")])
        raise KnotError(f"the Gauss code has {parts} components: it is a link; one cable is one")
    body = re.sub(r"[−–]", "-", text).strip(" \t\r\n()[]{}")
    tokens = [token for token in re.split(r"[,\s]+", body) if token]
    if not tokens:
        raise KnotError('the Gauss code is empty; a cable without a knot is named "unknot"')
    joined = "".join(tokens)
    if _SIGNED.match(joined):
        return _signed_tokens(tokens)
    trailing = any(token[-1] in "+-" for token in tokens)
    pattern = _PAPER if trailing else _INTEGER
    passes: list[tuple[int, bool]] = []
    for place, token in enumerate(tokens, 1):
        match = pattern.fullmatch(token)
        if match is None and trailing and _PAPER.sub("", token) == "":
            passes.extend((int(k), mark == "+") for k, mark in _PAPER.findall(token))
        elif match is None or not int(match[1 if trailing else 2]):
            expected = 'a crossing and a mark such as "3+"' if trailing else 'such as "-3"'
            raise KnotError(f'Gauss code, entry {place}: expected {expected}, got "{token}"')
        elif trailing:
            passes.append((int(match[1]), match[2] == "+"))
        else:
            passes.append((int(match[2]), match[1] != "-"))
    check_labels(passes)
    return ParsedGauss(tuple(passes), None)


def _signed_tokens(tokens: Sequence[str]) -> ParsedGauss:
    passes: list[tuple[int, bool]] = []
    signs: list[int] = []
    for place, token in enumerate(tokens, 1):
        if _SIGNED.sub("", token):
            raise KnotError(f'Gauss code, entry {place}: expected such as "O3+", got "{token}"')
        for mark, label, sign in _SIGNED.findall(token):
            passes.append((int(label), mark in "Oo"))
            signs.append(1 if sign == "+" else -1)
    check_labels(passes)
    text = ParsedGauss(tuple(passes), tuple(signs))
    text.signed()
    return text
