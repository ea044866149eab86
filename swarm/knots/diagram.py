"""Planar diagrams of knots: Gauss, DT and PD codes in and out, realisability, simplification.

A :class:`Diagram` is a closed signed Gauss code of genus 0, the code of a curve in the plane (or on
the sphere). Codes without crossing signs give all diagrams that they can mean: a prime code means
two, mirror images of each other; every further summand doubles their number.

Diagrams are simplified by Reidemeister moves and rerouted overpasses. An overpass (a maximal run of
over passes) can be moved to any other path between its two ends that passes over all strands there.
The shortest path in the dual graph has the fewest crossings. Underpasses are analogous. This
includes Reidemeister moves 1 and 2 and most uses of move 3.
"""

import itertools
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from random import Random

import numpy as np

from swarm.knots.gauss import KnotError, ParsedGauss, SignedGauss, parse_gauss

Pass = tuple[int, bool, int]

MAX_REALISATIONS = 64
"""Largest number of diagrams of a code without signs."""


@dataclass(frozen=True)
class Diagram:
    """A knot diagram on the sphere. Raises KnotError if no plane curve has this code."""

    code: SignedGauss

    def __post_init__(self) -> None:
        if not self.code.closed:
            raise KnotError("a diagram needs a closed code")
        if len(self.faces) != self.crossings + 2:
            raise KnotError("no curve in the plane has this signed Gauss code")

    @property
    def crossings(self) -> int:
        """Number of crossings."""
        return self.code.crossings

    @property
    def writhe(self) -> int:
        """Sum of the crossing signs."""
        return self.code.writhe

    @property
    def alternating(self) -> bool:
        """Whether over and under passes alternate."""
        levels = [over for _, over, _ in self.code.passes]
        return all(first != second for first, second in itertools.pairwise(levels))

    @cached_property
    def faces(self) -> tuple[tuple[int, ...], ...]:
        """Faces, each as the half edges with the face on their left (``2·edge + backward``).

        Edge k runs from pass k to the next pass. A circle without crossings has two faces.
        """
        return faces(self.code)

    def mirrored(self) -> "Diagram":
        """Return the mirror image."""
        return Diagram(self.code.mirrored())

    def pd(self) -> tuple[tuple[int, int, int, int], ...]:
        """Return the planar diagram code: edges per crossing, counterclockwise from incoming under.

        Edges are numbered 1…2n along the knot (KnotTheory's convention, also KnotInfo's).
        """
        partner = partners(self.code.passes)
        edges = len(self.code.passes)
        rows = []
        for position, (_, over, sign) in enumerate(self.code.passes):
            if over:
                continue
            under_in, under_out = (position - 1) % edges + 1, position + 1
            over_in, over_out = (partner[position] - 1) % edges + 1, partner[position] + 1
            if sign > 0:
                rows.append((under_in, over_out, under_out, over_in))
            else:
                rows.append((under_in, over_in, under_out, over_out))
        return tuple(rows)

    def dt(self) -> tuple[int, ...]:
        """Return the Dowker–Thistlethwaite code: per odd 1, 3, … the even number at its crossing.

        An even number is negative where its pass is like the code's first pass (both over or both
        under); an alternating diagram has one sign only. The mirror image has the same code.
        """
        partner = partners(self.code.passes)
        if not partner:
            return ()
        first_over = self.code.passes[0][1]
        return tuple(
            -(partner[k] + 1) if self.code.passes[partner[k]][1] == first_over else partner[k] + 1
            for k in range(0, len(partner), 2)
        )


def partners(passes: Sequence[Pass]) -> list[int]:
    """Return for each pass the position of the other pass of its crossing."""
    where: dict[int, int] = {}
    partner = [0] * len(passes)
    for position, (label, _, _) in enumerate(passes):
        if label in where:
            partner[position], partner[where[label]] = where[label], position
        where[label] = position
    return partner


def faces(code: SignedGauss) -> tuple[tuple[int, ...], ...]:
    """Return the faces of the surface of a closed code (see :attr:`Diagram.faces`)."""
    count = len(code.passes)
    if not count:
        return ((0,), (1,))
    partner = partners(code.passes)
    follows = [0] * (2 * count)
    for position, (_, over, sign) in enumerate(code.passes):
        other = partner[position]
        crosses_to_left = (sign > 0) == over
        # Arriving forward, the leftmost way on is along the other strand, out or back in.
        follows[2 * ((position - 1) % count)] = (
            2 * other if crosses_to_left else 2 * ((other - 1) % count) + 1
        )
        follows[2 * position + 1] = 2 * ((other - 1) % count) + 1 if crosses_to_left else 2 * other
    return tuple(map(tuple, _cycles(follows)))


def _cycles(follows: list[int]) -> list[list[int]]:
    """Return the cycles of a permutation, each from its smallest element on."""
    cycles = []
    seen = [False] * len(follows)
    for start in range(len(follows)):
        cycle = []
        half = start
        while not seen[half]:
            seen[half] = True
            cycle.append(half)
            half = follows[half]
        if cycle:
            cycles.append(cycle)
    return cycles


def realisations(passes: Sequence[tuple[int, bool]]) -> tuple[Diagram, ...]:
    """Return all diagrams on the sphere that a Gauss code without signs can mean.

    A prime code has two, mirror images; a code of k indecomposable parts has 2^k. The signs
    follow from which pairs of crossings interlace (Cairns and Elton 1993, "The planarity problem
    for signed Gauss words"). The first diagram's first crossing is positive.

    Raises KnotError for invalid labels, or where no plane curve has the code.
    """
    listed = tuple(passes)
    plain = SignedGauss.of(((k, over, 1) for k, over in listed), closed=True)
    if not listed:
        return (Diagram(plain),)
    where: dict[int, list[int]] = {}
    for position, (label, _, _) in enumerate(plain.passes):
        where.setdefault(label, []).append(position)
    ends = np.array([where[label] for label in sorted(where)])
    unrealisable = KnotError("no curve in the plane has this Gauss code")
    if np.any((ends[:, 1] - ends[:, 0]) % 2 == 0):
        label = int(np.flatnonzero((ends[:, 1] - ends[:, 0]) % 2 == 0)[0]) + 1
        name = listed[ends[label - 1, 0]][0]
        raise KnotError(
            f"no curve in the plane has this Gauss code: between the two passes of crossing {name} "
            "there is an odd number of passes"
        )
    turns, part = _turns(ends)
    if turns is None:
        raise unrealisable
    parts = int(part.max()) + 1
    if 2**parts > MAX_REALISATIONS:
        raise KnotError(
            f"the Gauss code consists of {parts} parts, each of either chirality: "
            "give crossing signs"
        )
    diagrams = []
    for flips in itertools.product((1, -1), repeat=parts):
        turn = turns * np.array(flips)[part]
        first_over = np.array([plain.passes[first][1] for first in ends[:, 0]])
        signs = np.where(first_over, turn, -turn)
        code = SignedGauss(
            tuple((k, over, int(signs[k - 1])) for k, over, _ in plain.passes), closed=True
        )
        if len(faces(code)) != len(ends) + 2:
            raise unrealisable
        diagrams.append(Diagram(code))
    return tuple(sorted(diagrams, key=lambda d: [-sign for _, _, sign in d.code.passes]))


def _turns(ends: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the direction in which each chord's second pass crosses its first, and its part.

    ``ends`` is (n, 2), positions of the two passes. +1 means from right to left.
    """
    count = len(ends)
    first, second = ends[:, 0], ends[:, 1]
    inside = (first[None, :] > first[:, None]) & (first[None, :] < second[:, None])
    crosses = inside & (second[None, :] > second[:, None])
    crosses = crosses | crosses.T
    common_odd = (crosses.astype(np.int64) @ crosses.astype(np.int64)) % 2 == 1
    # With x = turn × (−1)^first position, interlaced chords have equal x exactly where the number
    # of chords that interlace both is odd.
    unknown = np.zeros(count, dtype=np.int64)
    part = np.full(count, -1)
    parts = 0
    for root in range(count):
        if unknown[root]:
            continue
        unknown[root], part[root] = 1, parts
        waiting = [root]
        while waiting:
            chord = waiting.pop()
            for other in np.flatnonzero(crosses[chord]):
                value = unknown[chord] * (1 if common_odd[chord, other] else -1)
                if not unknown[other]:
                    unknown[other], part[other] = value, parts
                    waiting.append(int(other))
                elif unknown[other] != value:
                    return None, part
        parts += 1
    return unknown * np.where(first % 2 == 0, 1, -1), part


def diagrams_of_gauss(text: str | ParsedGauss) -> tuple[Diagram, ...]:
    """Return all diagrams that a written Gauss code can mean; one if it has signs."""
    read = parse_gauss(text) if isinstance(text, str) else text
    signed = read.signed()
    return realisations(read.passes) if signed is None else (Diagram(signed),)


def diagrams_of_dt(dt: Sequence[int]) -> tuple[Diagram, ...]:
    """All diagrams that a Dowker–Thistlethwaite code can mean.

    A negative entry marks the crossings where the odd pass goes over instead of under.
    Raises KnotError that names each entry that is odd, missing or repeated.
    """
    wrong = [f"entry {k}: expected an even number, got {d}" for k, d in enumerate(dt, 1) if d % 2]
    count = len(dt)
    if not count:
        raise KnotError('the DT code is empty; a cable without a knot is named "unknot"')
    if not wrong and sorted(abs(d) for d in dt) != list(range(2, 2 * count + 1, 2)):
        wrong.append(f"expected each of 2, 4, …, {2 * count} once (with either sign)")
    if wrong:
        raise KnotError("DT code: " + "; ".join(wrong))
    passes: list[tuple[int, bool]] = [(0, False)] * (2 * count)
    for k, even in enumerate(dt):
        passes[2 * k] = (k + 1, even < 0)
        passes[abs(even) - 1] = (k + 1, even > 0)
    try:
        return realisations(passes)
    except KnotError as error:
        raise KnotError(f"DT code: {error}") from None


def diagram_of_pd(pd: Iterable[Sequence[int]]) -> Diagram:
    """Return the diagram of a planar diagram code (KnotTheory's convention).

    Each crossing lists its four edges counterclockwise from an under edge; edges may have any
    numbers. Raises KnotError for invalid entries, a link, or a code that no plane curve has.
    """
    rows = [tuple(row) for row in pd]
    if not rows:
        raise KnotError('the PD code is empty; a cable without a knot is named "unknot"')
    slots: dict[int, list[tuple[int, int]]] = {}
    for crossing, row in enumerate(rows):
        if len(row) != 4:
            raise KnotError(f"PD code, crossing {crossing + 1}: expected 4 edges, got {len(row)}")
        for slot, edge in enumerate(row):
            slots.setdefault(edge, []).append((crossing, slot))
    wrong = [f"edge {edge} occurs {len(at)} times" for edge, at in slots.items() if len(at) != 2]
    if wrong:
        raise KnotError("PD code: " + "; ".join(wrong) + " (expected twice each)")
    crossing, slot = 0, 0
    entered: list[tuple[int, int]] = []
    while (crossing, slot) not in entered[:1]:
        entered.append((crossing, slot))
        leaves = (crossing, (slot + 2) % 4)
        here, there = slots[rows[crossing][leaves[1]]]
        crossing, slot = there if here == leaves else here
    if len(entered) != 2 * len(rows):
        raise KnotError("the PD code is that of a link; one cable has one component")
    under_slot = {k: slot for k, slot in entered if slot % 2 == 0}
    passes = []
    for k, slot in entered:
        over_slot = slot if slot % 2 else next(s for c, s in entered if c == k and s % 2)
        # Counterclockwise from the incoming under edge: over leaving first is a positive crossing.
        sign = -1 if (over_slot - under_slot[k]) % 4 == 1 else 1
        passes.append((k + 1, slot % 2 == 1, sign))
    try:
        return Diagram(SignedGauss.of(passes, closed=True))
    except KnotError:
        raise KnotError("no curve in the plane has this PD code") from None


MOST_CROSSINGS = 2000
"""Most crossings of a diagram whose strands are led elsewhere: 2,617 random ones took 20 s."""


def simplified(diagram: Diagram, *, kicks: int = 0) -> Diagram:
    """Return a diagram of the same knot with at most as many crossings. Deterministic.

    Where no overpass or underpass can be shortened, up to ``kicks`` of them are moved to another
    path of the same length, which may permit a shorter one. Raises :class:`KnotError` for a
    diagram of more than MOST_CROSSINGS that no removal of loops and of overlaps makes smaller.
    """
    passes = _reduced(list(diagram.code.passes))
    if len(passes) > 2 * MOST_CROSSINGS:
        raise KnotError(
            f"{len(passes) // 2} crossings are left after the simple moves; at most "
            f"{MOST_CROSSINGS} are simplified further, in half a minute"
        )
    rng = Random(1)
    best = passes
    remaining = kicks
    while passes:
        passes = _unturned(passes)
        shorter = _rerouted(passes, None)
        if shorter is None:
            if len(passes) < len(best):
                best, remaining = passes, kicks
            if not remaining:
                break
            remaining -= 1
            shorter = _rerouted(passes, rng)
            if shorter is None:
                break
        passes = _reduced(shorter)
    if len(passes) < len(best):
        best = passes
    return Diagram(SignedGauss.of(best, closed=True))


def without_nugatory(diagram: Diagram) -> Diagram:
    """Return the diagram without nugatory crossings: the part behind each is turned over."""
    passes = _unturned(list(diagram.code.passes))
    return Diagram(SignedGauss.of(passes, closed=True))


def _unturned(passes: list[Pass]) -> list[Pass]:
    """Return the passes without nugatory crossings; the part between is turned by 180°."""
    changed = True
    while changed:
        changed = False
        partner = partners(passes)
        for here, there in enumerate(partner):
            if here < there and all(here < partner[k] < there for k in range(here + 1, there)):
                inside = [(k, not over, sign) for k, over, sign in passes[here + 1 : there]]
                passes = passes[:here] + inside + passes[there + 1 :]
                changed = True
                break
    return passes


def _reduced(passes: list[Pass]) -> list[Pass]:
    """Return the passes without all kinks and pairs that Reidemeister moves 1 and 2 remove.

    Where crossings x, y are adjacent on two strands and one strand is on top at both, the strands
    can be separated: the upper one moves to the other side of the lower one.
    """
    count = len(passes)
    after = [*range(1, count), 0] if count else []
    before = [count - 1, *range(count - 1)] if count else []
    alive = [True] * count
    partner = partners(passes)
    waiting = list(range(count))
    remaining = count

    def drop(position: int) -> None:
        nonlocal remaining
        for at in (position, partner[position]):
            alive[at] = False
            remaining -= 1
            prior, following = before[at], after[at]
            after[prior], before[following] = following, prior
            waiting.extend((prior, following, before[prior]))

    while waiting and remaining > 0:
        here = waiting.pop()
        if not alive[here]:
            continue
        there = after[here]
        if partner[here] == there:
            drop(here)
        elif passes[here][1] == passes[there][1]:
            first, second = partner[here], partner[there]
            if after[first] == second or after[second] == first:
                drop(here)
                drop(there)
    return [item for item, kept in zip(passes, alive, strict=True) if kept]


def _runs(passes: list[Pass]) -> Iterator[tuple[int, int]]:
    """Return (start, length) of each maximal run of passes on one level, longest first."""
    count = len(passes)
    starts = [k for k in range(count) if passes[k][1] != passes[k - 1][1]]
    runs = [
        (start, (following - start) % count or count)
        for start, following in zip(starts, starts[1:] + starts[:1], strict=True)
    ]
    return iter(sorted(runs, key=lambda run: -run[1]))


def _rerouted(passes: list[Pass], rng: Random | None) -> list[Pass] | None:
    """Return the passes with a run on a shorter path; with ``rng``, on another path as long."""
    runs = list(_runs(passes))
    if rng is not None:
        rng.shuffle(runs)
    for start, length in runs:
        turned = passes[start:] + passes[:start]
        run, arc = turned[:length], turned[length:]
        gone = {label for label, _, _ in run}
        arc = [item for item in arc if item[0] not in gone]
        path = _shortest_path(arc, length if rng is None else length + 1, rng)
        if path is None:
            continue
        laid = _with_run(arc, path, run[0][1])
        if rng is None or laid != arc + run:
            return laid
    return None


def _shortest_path(arc: list[Pass], below: int, rng: Random | None) -> list[int] | None:
    """Return the half edges crossed (from their left side) from the arc's last edge to its first.

    Only paths of fewer than ``below`` crossings count. Edge k of the arc leads to its pass k; half
    edge 2k has the same direction, 2k + 1 the opposite one.
    """
    count = len(arc)
    face_of, on_face = _arc_faces(arc)
    start, goal = face_of[2 * count], face_of[0]
    came: dict[int, int] = {start: -1}
    waiting = deque([(start, 0)])
    while waiting and goal not in came:
        face, depth = waiting.popleft()
        if depth + 1 >= below:
            break
        halves = on_face[face]
        if rng is not None:
            rng.shuffle(halves)
        for half in halves:
            beyond = face_of[half ^ 1]
            if beyond not in came:
                came[beyond] = half
                waiting.append((beyond, depth + 1))
    if goal not in came:
        return None
    path = []
    face = goal
    while came[face] >= 0:
        path.append(came[face])
        face = face_of[came[face]]
    return path[::-1]


def _arc_faces(arc: list[Pass]) -> tuple[list[int], list[list[int]]]:
    """Return the face left of each half edge of an open arc's diagram, and each face's edges."""
    count = len(arc)
    partner = partners(arc)
    follows = [0] * (2 * count + 2)
    follows[2 * count], follows[1] = 2 * count + 1, 0
    for position, (_, over, sign) in enumerate(arc):
        other = partner[position]
        to_left = (sign > 0) == over
        # Edge `position` leads into this pass, edge `position + 1` out of it.
        follows[2 * position] = 2 * (other + 1) if to_left else 2 * other + 1
        follows[2 * position + 3] = 2 * other + 1 if to_left else 2 * (other + 1)
    on_face = _cycles(follows)
    face_of = [0] * len(follows)
    for face, halves in enumerate(on_face):
        for half in halves:
            face_of[half] = face
    return face_of, on_face


def _with_run(arc: list[Pass], path: list[int], over: bool) -> list[Pass]:
    """Return the closed code of the arc with a run along ``path``, over or under all strands."""
    label = max((k for k, _, _ in arc), default=0)
    met: dict[int, Pass] = {}
    run: list[Pass] = []
    for half in path:
        label += 1
        # From left to right over a strand that runs up: over × under points up.
        sign = 1 if (half % 2 == 0) == over else -1
        met[half // 2] = (label, not over, sign)
        run.append((label, over, sign))
    result: list[Pass] = []
    for edge in range(len(arc) + 1):
        if edge in met:
            result.append(met[edge])
        if edge < len(arc):
            result.append(arc[edge])
    return result + run
