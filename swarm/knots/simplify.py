"""Simplification of diagrams: Reidemeister moves and rerouted overpasses.

An overpass (a maximal run of over passes) can be moved to any other path between its two ends that
passes over all strands there. The shortest path in the dual graph has the fewest crossings.
Underpasses are analogous. This includes Reidemeister moves 1 and 2 and most uses of move 3.
"""

from collections import deque
from collections.abc import Iterator
from random import Random

from swarm.knots.diagram import Diagram
from swarm.knots.gauss import KnotError, SignedGauss

Pass = tuple[int, bool, int]

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
    left = kicks
    while passes:
        passes = _unturned(passes)
        shorter = _rerouted(passes, None)
        if shorter is None:
            if len(passes) < len(best):
                best, left = passes, kicks
            if not left:
                break
            left -= 1
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
    found = True
    while found:
        found = False
        partner = _partners(passes)
        for here, there in enumerate(partner):
            if here < there and all(here < partner[k] < there for k in range(here + 1, there)):
                inside = [(k, not over, sign) for k, over, sign in passes[here + 1 : there]]
                passes = passes[:here] + inside + passes[there + 1 :]
                found = True
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
    partner = _partners(passes)
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
            one, two = partner[here], partner[there]
            if after[one] == two or after[two] == one:
                drop(here)
                drop(there)
    return [item for item, kept in zip(passes, alive, strict=True) if kept]


def _partners(passes: list[Pass]) -> list[int]:
    where: dict[int, int] = {}
    partner = [0] * len(passes)
    for position, (label, _, _) in enumerate(passes):
        if label in where:
            partner[position], partner[where[label]] = where[label], position
        where[label] = position
    return partner


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
    partner = _partners(arc)
    follows = [0] * (2 * count + 2)
    follows[2 * count], follows[1] = 2 * count + 1, 0
    for position, (_, over, sign) in enumerate(arc):
        other = partner[position]
        to_left = (sign > 0) == over
        # Edge `position` leads into this pass, edge `position + 1` out of it.
        follows[2 * position] = 2 * (other + 1) if to_left else 2 * other + 1
        follows[2 * position + 3] = 2 * other + 1 if to_left else 2 * (other + 1)
    face_of = [-1] * len(follows)
    on_face: list[list[int]] = []
    for start in range(len(follows)):
        if face_of[start] >= 0:
            continue
        halves = []
        half = start
        while face_of[half] < 0:
            face_of[half] = len(on_face)
            halves.append(half)
            half = follows[half]
        on_face.append(halves)
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
