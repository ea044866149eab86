"""Smallest margins by branch and bound, where bounds converge and where they do not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.certification.branch_and_bound import Boxes, Enclosure, _halved
from swarm.certification.minima import (
    MOST_BOXES,
    TOLERANCE,
    failing,
    most_steps,
    roots,
    smallest,
    smallest_in_boxes,
)

SPAN = [(0.0, 4.0)]


def margins(*functions, loose=0.0):
    """An evaluator of functions of time with slopes up to 1 per second.

    The bound of the first pair stays ``loose`` below the value.
    """

    def evaluate(boxes):
        (time,), (half,) = boxes.middle.T, boxes.half.T
        value = np.array([functions[p](t) for p, t in zip(boxes.group, time, strict=True)])
        low = value - half - loose * (boxes.group == 0)
        return Enclosure(low, value + half, half[:, None] + 1e-12, np.zeros((len(boxes), 3)))

    return evaluate


def steady(margin):
    return lambda _time: margin


def test_margins_that_cannot_be_shown_come_first():
    kept = [steady(0.1 + 0.01 * k) for k in range(8)]
    evaluate = margins(steady(0.9), *kept, loose=1.0)
    found = smallest(evaluate, 9, roots(9, SPAN, 1.0))
    assert found.tightest()[0] == 0
    assert found.low[0] == pytest.approx(-0.1, abs=0.01)


@pytest.mark.parametrize("least", [0.05 * TOLERANCE * 1.01, 0.5 * TOLERANCE, 2.0 * TOLERANCE])
def test_a_margin_just_above_zero_is_not_refused_by_the_tolerance(least):
    found = smallest(margins(lambda t: least + abs(t - 1.3)), 1, roots(1, SPAN, 1.0))
    assert 0.0 <= found.low[0] <= least


@pytest.mark.parametrize("least", [-1e-6, -0.5 * TOLERANCE])
def test_a_margin_just_below_zero_is_refused(least):
    found = smallest(margins(lambda t: least + abs(t - 1.3)), 1, roots(1, SPAN, 1.0))
    assert found.low[0] <= least


def test_exactly_the_failing_seconds_are_found():
    def dipping(t):
        return 0.2 - 0.3 * max(1.0 - 4.0 * abs(t - 0.4), 1.0 - 2.0 * abs(t - 2.6), 0.0)

    boxes = roots(2, SPAN, 1.0)
    found = smallest_in_boxes(margins(steady(1.0), dipping), boxes)
    short = np.flatnonzero(found.low < 0.0)
    assert [(int(boxes.group[k]), float(boxes.middle[k, 0])) for k in short] == [(1, 0.5), (1, 2.5)]
    assert found.time[short] == pytest.approx([0.4, 2.6], abs=0.02)
    assert found.low[short] == pytest.approx([-0.1, -0.1], abs=0.02)


def test_the_bound_of_a_box_holds_in_its_parts():
    """Bounds of parts can be weaker; the known bound stays."""

    def evaluate(boxes):
        whole = boxes.half[:, 0] >= 0.5
        low, high = np.where(whole, 0.005, -0.1), np.where(whole, 0.02, -0.1)
        return Enclosure(low, high, boxes.half, np.zeros((len(boxes), 3)))

    assert smallest(evaluate, 1, roots(1, SPAN, 1.0)).low[0] == 0.005


def test_every_span_has_boxes_of_the_given_width():
    boxes = roots(2, [(0.0, 4.0), (10.0, 14.0), (20.0, 20.5), (30.0, 32.2)], 1.0)
    assert np.unique(boxes.half) == pytest.approx([0.25, 2.2 / 6, 0.5])
    assert len(boxes) == 2 * (4 + 4 + 1 + 3)


def test_the_parts_of_boxes_fill_them_without_overlap():
    rng = np.random.default_rng(4)
    middle, half, widths = rng.uniform(0.1, 1.0, (3, 40, 4))
    boxes = Boxes(np.arange(40), middle, half, np.zeros(40))
    found = Enclosure(rng.uniform(size=40), np.ones(40), widths, middle[:, :3])
    where = rng.permutation(40)[:25]
    parts = _halved(boxes, found, where, 0.5)
    assert parts.group[np.sort(np.unique(parts.group, return_index=True)[1])].tolist() == [*where]
    assert (parts.known == found.low[parts.group]).all()
    for k in where:
        own = parts.taken(parts.group == k)
        cut = widths[k] >= 0.5 * widths[k].max()
        assert (own.half == np.where(cut, 0.5, 1.0) * half[k]).all()
        steps = (own.middle - middle[k]) / half[k]
        sides = np.sign(steps[:, cut])
        assert np.allclose(abs(steps), np.where(cut, 0.5, 0.0))
        assert len(np.unique(sides, axis=0)) == len(own) == 2 ** cut.sum()


def test_boxes_that_halve_to_themselves_are_not_shown():
    """Beside 2⁵³ s, a box and its halves have the same middle; between them lie gaps."""
    begun = roots(1, [(2.0**53, 2.0**53 + 42.0)], 1.0)
    flat = enclosing(-0.1, 0.1, 0.2)
    assert failing(flat, begun) is not None
    assert smallest(flat, 1, begun).low.tolist() == [-np.inf]


def enclosing(low, high, width):
    """An evaluator with the same enclosure for every box."""

    def evaluate(boxes):
        size = len(boxes)
        place, widths = np.zeros((size, 3)), np.full(boxes.half.shape, width)
        return Enclosure(np.full(size, low), np.full(size, high), widths, place)

    return evaluate


def test_a_search_that_does_not_converge_ends_with_its_bounds():
    begun = roots(1, SPAN, 1.0)
    found = smallest(enclosing(-0.5, 1.0, 1.0), 1, begun)
    assert found.boxes < 10 * MOST_BOXES
    assert found.low.tolist() == [-0.5]
    assert failing(enclosing(-0.5, 1.0, 1.0), begun) is not None


@pytest.mark.parametrize(
    ("low", "high", "width"),
    [(np.inf, np.inf, 0.0), (np.nan, 1.0, 1.0), (1.0, np.nan, 1.0), (-np.inf, 1.0, np.nan)],
)
def test_a_missing_margin_is_never_cleared(low, high, width):
    """No box counts, or the margin is not a number."""
    begun = roots(2, SPAN, 1.0)

    def evaluate(boxes):
        first = boxes.group == 0
        found = enclosing(low, high, width)(boxes)
        kept = enclosing(0.3, 0.3, 0.0)(boxes)
        return Enclosure(
            np.where(first, found.low, kept.low),
            np.where(first, found.high, kept.high),
            np.where(first[:, None], found.widths, kept.widths),
            found.place,
        )

    found = smallest(evaluate, 2, begun)
    assert found.low.tolist() == [-np.inf, pytest.approx(0.3)]
    assert found.tightest().tolist() == [0, 1]
    assert failing(evaluate, begun) is not None
    short = smallest_in_boxes(evaluate, begun).low < 0.0
    assert short.tolist() == [True] * 4 + [False] * 4


STEP = 0.01


def falling(functions, seen):
    """Evaluators of functions of time that fall by a step each, and count their boxes."""

    def at(steps):
        assert steps > 0
        evaluate = margins(*(lambda t, f=f: f(t) - steps * STEP for f in functions))

        def counted(boxes):
            seen.append(len(boxes))
            return evaluate(boxes)

        return counted

    return at


@given(st.lists(st.tuples(st.floats(-0.05, 1.2), st.floats(0.0, 4.0)), min_size=1, max_size=4))
def test_the_most_steps_are_those_of_the_smallest_margin(dips):
    """To the tolerance, whatever margins the steps before were lost at."""
    functions = [lambda t, low=low, at=at: low + abs(t - at) for low, at in dips]
    least = min(low for low, _ in dips)
    seen = []
    most = most_steps(falling(functions, seen), 100, roots(len(dips), SPAN, 1.0))
    assert most == 0 or least - most * STEP >= 0.0
    assert most + 1 >= min((least - TOLERANCE) / STEP, 100)
    assert sum(seen) < 2000


def test_a_search_that_does_not_converge_shows_no_steps():
    counted = []

    def at(_steps):
        def evaluate(boxes):
            counted.append(len(boxes))
            return enclosing(-0.5, 1.0, 1.0)(boxes)

        return evaluate

    assert most_steps(at, 10**4, roots(1, SPAN, 1.0)) == 0
    assert sum(counted) < 3 * MOST_BOXES


def test_a_missing_margin_shows_no_steps():
    assert most_steps(lambda _: enclosing(np.inf, np.inf, 0.0), 9, roots(2, SPAN, 1.0)) == 0
    assert most_steps(lambda _: enclosing(np.nan, 1.0, 1.0), 9, roots(2, SPAN, 1.0)) == 0
