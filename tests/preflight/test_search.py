"""Enclosing the smallest of many functions, where bounds converge and where they do not."""

import numpy as np
import pytest

from swarm.preflight.search import TOLERANCE, Enclosure, roots, short_boxes, smallest

SPAN = [(0.0, 4.0)]


def margins(*functions, loose=0.0):
    """An evaluator of functions of time that change by at most 1 a second.

    The bound of the first pair never gets nearer to it than ``loose``.
    """

    def evaluate(boxes):
        value = np.array([functions[p](t) for p, t in zip(boxes.pair, boxes.time, strict=True)])
        low = value - boxes.half - loose * (boxes.pair == 0)
        nothing = np.zeros(len(boxes))
        doubts = np.stack([boxes.half + 1e-12, nothing, nothing], axis=1)
        return Enclosure(low, value + boxes.half, doubts, np.zeros((len(boxes), 3)))

    return evaluate


def steady(margin):
    return lambda _time: margin


def test_what_cannot_be_shown_comes_before_what_is_tighter_but_kept():
    kept = [steady(0.1 + 0.01 * k) for k in range(8)]
    evaluate = margins(steady(0.9), *kept, loose=1.0)
    found = smallest(evaluate, 9, roots(9, SPAN, 1.0))
    assert found.tightest()[0] == 0
    assert found.low[0] == pytest.approx(-0.1, abs=0.01)


@pytest.mark.parametrize("least", [0.05 * TOLERANCE * 1.01, 0.5 * TOLERANCE, 2.0 * TOLERANCE])
def test_a_margin_just_above_nothing_is_not_refused_for_the_tolerance(least):
    found = smallest(margins(lambda t: least + abs(t - 1.3)), 1, roots(1, SPAN, 1.0))
    assert 0.0 <= found.low[0] <= least


@pytest.mark.parametrize("least", [-1e-6, -0.5 * TOLERANCE])
def test_a_margin_just_below_nothing_is_refused(least):
    found = smallest(margins(lambda t: least + abs(t - 1.3)), 1, roots(1, SPAN, 1.0))
    assert found.low[0] <= least


def test_every_second_that_falls_short_is_found_and_no_other():
    def dipping(t):
        return 0.2 - 0.3 * max(1.0 - 4.0 * abs(t - 0.4), 1.0 - 2.0 * abs(t - 2.6), 0.0)

    boxes = roots(2, SPAN, 1.0)
    found = short_boxes(margins(steady(1.0), dipping), boxes)
    short = np.flatnonzero(found.low < 0.0)
    assert [(int(boxes.pair[k]), float(boxes.time[k])) for k in short] == [(1, 0.5), (1, 2.5)]
    assert found.time[short] == pytest.approx([0.4, 2.6], abs=0.02)
    assert found.low[short] == pytest.approx([-0.1, -0.1], abs=0.02)


def test_what_was_shown_of_a_box_holds_in_its_parts():
    """Bounds of parts may be poorer, by another way to find them; what is known stays known."""

    def evaluate(boxes):
        whole = boxes.half >= 0.5
        doubts = np.stack([boxes.half, 0.0 * boxes.half, 0.0 * boxes.half], axis=1)
        low, high = np.where(whole, 0.005, -0.1), np.where(whole, 0.02, -0.1)
        return Enclosure(low, high, doubts, np.zeros((len(boxes), 3)))

    assert smallest(evaluate, 1, roots(1, SPAN, 1.0)).low[0] == 0.005
