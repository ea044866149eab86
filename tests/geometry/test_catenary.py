"""Catenaries against quadrature in many digits, against limits and their own symmetries."""

import re

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.errors import SwarmError
from swarm.geometry.catenary import (
    STANDARD_GRAVITY,
    Catenaries,
    OverStretched,
    length_for_sag,
    sag_for_drop,
    sag_for_length,
    solve_catenaries,
    solve_half_angle,
)

# Span, rise, length: level and inclined, from slack 1e-6 to length/span 1e3.
SHAPES = [
    (4.0, rise, float(np.hypot(4.0, rise)) * (1.0 + slack))
    for rise in (0.0, 1.5, -9.0)
    for slack in (1e-6, 1e-4, 0.02, 0.3, 4.0)
] + [
    (1.0, 0.0, 1e3),
    (0.01, 3.0, 3.0001),
    (0.01, 3.0, 10.0),
    (2.0, -400.0, 1e3),
]


def quadrature_oracle(span: float, rise: float, length: float, guess: Catenaries):
    """Solve equilibrium and closure by quadrature in 20 digits; only the first guess is shared.

    The tangent at arc length s is (1, (s − c)/a) normalised: constant horizontal tension, and a
    vertical one that grows by the weight of the cable. a and c follow from where the end is.
    """
    mpmath.mp.dps = 20
    span, rise, length = mpmath.mpf(span), mpmath.mpf(rise), mpmath.mpf(length)

    def reach(a, c, upto):
        cuts = [mpmath.mpf(0)]
        for width in (-1000, -30, -3, 0, 3, 30, 1000):
            cut = c + width * a
            if cuts[-1] < cut < upto:
                cuts.append(cut)
        cuts.append(upto)

        def tangent(s):
            steep = (s - c) / a
            return mpmath.mpc(1, steep) / mpmath.sqrt(1 + steep * steep)

        end = mpmath.quad(tangent, cuts)
        return end.real, end.imag

    def mismatch(log_a, slope):
        a = mpmath.exp(log_a)
        across, up = reach(a, -slope * a, length)
        return across / span - 1, (up - rise) / length

    a = mpmath.mpf(float(guess.parameter))
    start = (mpmath.log(a), mpmath.mpf(float(guess.slope)))
    log_a, slope = mpmath.findroot(mismatch, start, tol=1e-30, maxsteps=20)
    a = mpmath.exp(log_a)
    return a, lambda fraction: reach(a, -slope * a, length * mpmath.mpf(fraction))


@pytest.mark.slow
@pytest.mark.parametrize(("span", "rise", "length"), SHAPES)
def test_shape_and_tension_match_quadrature(span: float, rise: float, length: float) -> None:
    strand = solve_catenaries([0.0, 0.0, 0.0], [span, 0.0, rise], length)
    a, point = quadrature_oracle(span, rise, length, strand)
    assert float(strand.parameter) == pytest.approx(float(a), rel=1e-9)
    scale = max(span, abs(rise))
    for fraction in (0.1, 0.5, 0.9):
        across, up = point(fraction)
        found = strand.points_at(fraction)
        assert found[0] == pytest.approx(float(across), abs=1e-9 * scale)
        assert found[2] == pytest.approx(float(up), abs=1e-9 * scale)
        below_chord = found[2] - rise * found[0] / span
        expected = up - mpmath.mpf(rise) * across / mpmath.mpf(span)
        assert below_chord == pytest.approx(float(expected), rel=1e-9, abs=1e-14 * length)


def test_sampling_in_bulk_equals_single_points() -> None:
    rng = np.random.default_rng(3)
    start, end = rng.normal(size=(2, 7, 5, 3))
    length = np.linalg.norm(end - start, axis=-1) * (1.0 + 10.0 ** rng.uniform(-8, 2, (7, 5)))
    down = rng.normal(size=(5, 3))
    strands = solve_catenaries(start, end, length, down=down)
    fractions = np.array([0.0, 0.2, 0.7, 1.0])
    bulk = strands.points(fractions)
    assert bulk.shape == (7, 5, 4, 3)
    for k, fraction in enumerate(fractions):
        apart = np.abs(bulk[..., k, :] - strands.points_at(fraction)).max(axis=-1)
        assert (apart / length).max() < 2e-14
    one = solve_catenaries(start[3, 2], end[3, 2], length[3, 2], down=down[2])
    np.testing.assert_allclose(one.points(fractions), bulk[3, 2], rtol=0.0, atol=1e-13)


def test_large_batches_are_sampled_like_small_ones() -> None:
    end = np.column_stack([np.linspace(1.0, 2.0, 9_000), np.zeros(9_000), np.zeros(9_000)])
    bulk = solve_catenaries(np.zeros(3), end, 2.5).points(np.linspace(0.0, 1.0, 9))
    pick = [0, 4_095, 4_096, 8_999]
    np.testing.assert_array_equal(
        bulk[pick], solve_catenaries(np.zeros(3), end[pick], 2.5).points(np.linspace(0.0, 1.0, 9))
    )


@pytest.mark.parametrize("rise", [0.0, 1.2, -1.2])
def test_a_vertical_strand_is_a_hairpin(rise: float) -> None:
    strand = solve_catenaries([1.0, 2.0, 3.0], [1.0, 2.0, 3.0 + rise], 2.0)
    lowest = 3.0 - (2.0 - rise) / 2.0
    np.testing.assert_allclose(strand.lowest(), [1.0, 2.0, lowest], atol=1e-12)
    fractions = np.linspace(0.0, 1.0, 11)
    expected = np.maximum(3.0 - 2.0 * fractions, 3.0 + rise - 2.0 * (1.0 - fractions))
    points = strand.points(fractions)
    np.testing.assert_allclose(points[:, 2], expected, atol=1e-12)
    np.testing.assert_allclose(points[:, :2], [[1.0, 2.0]] * 11, atol=1e-12)
    horizontal, at_start, at_end = strand.tension(0.5, gravity=10.0)
    assert horizontal == pytest.approx(0.0, abs=1e-12)
    assert at_start == pytest.approx(5.0 * (2.0 - rise) / 2.0)
    assert at_end == pytest.approx(5.0 * (2.0 + rise) / 2.0)


def test_a_vertical_strand_is_the_limit_of_short_spans() -> None:
    spans = 10.0 ** np.arange(-3.0, -60.0, -3.0)
    ends = np.stack([spans, 0 * spans, 0 * spans + 0.4], axis=-1)
    depths = solve_catenaries(np.zeros(3), ends, 2.0).lowest()[:, 2]
    np.testing.assert_allclose(depths, -0.8, atol=1e-3)
    np.testing.assert_allclose(depths[6:], -0.8, atol=1e-12)


def test_a_taut_strand_is_its_chord() -> None:
    end = np.array([3.0, 4.0, 12.0])
    strand = solve_catenaries(np.zeros(3), end, 13.0)
    fractions = np.linspace(0.0, 1.0, 5)
    np.testing.assert_allclose(strand.points(fractions), fractions[:, None] * end, atol=1e-11)
    assert strand.sag() == pytest.approx(0.0, abs=1e-12)
    assert strand.tension(0.01)[0] > 1e9


def test_over_stretched_strands_are_listed() -> None:
    start, end = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    end[..., 0] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    with pytest.raises(OverStretched) as caught:
        solve_catenaries(start, end, 4.5)
    assert isinstance(caught.value, SwarmError)
    assert caught.value.segments == [(1, 1), (1, 2)]
    assert str(caught.value) == (
        "over-stretched cable: segment 1, 1: its ends are 5 m apart, its cable is 4.5 m; "
        "segment 1, 2: its ends are 6 m apart, its cable is 4.5 m"
    )
    with pytest.raises(OverStretched, match=re.escape("and 5 more")):
        solve_catenaries(np.zeros(3), np.tile([2.0, 0.0, 0.0], (15, 1)), 1.0)


def test_rounding_is_not_stretch() -> None:
    solve_catenaries([0.1, 0.2, 0.3], [1.1, 0.2, 0.3], np.nextafter(1.0, 0.0))
    with pytest.raises(OverStretched):
        solve_catenaries([0.1, 0.2, 0.3], [1.1, 0.2, 0.3], 1.0 - 1e-9)


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan, np.inf])
def test_impossible_lengths_are_refused(length: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        solve_catenaries(np.zeros(3), np.zeros(3), length)


coordinates = st.floats(-20.0, 20.0).map(lambda v: round(v, 3))
vectors = st.tuples(coordinates, coordinates, coordinates).map(np.array)
slacks = st.floats(-6.0, 2.5).map(lambda v: 10.0**v)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 0.1)


@st.composite
def strands(draw: st.DrawFn) -> Catenaries:
    start, end = draw(vectors), draw(vectors)
    length = max(float(np.linalg.norm(end - start)), 0.01) * (1.0 + draw(slacks))
    return solve_catenaries(start, end, length, down=draw(directions))


@given(strands())
def test_a_strand_joins_its_ends_with_its_length(strand: Catenaries) -> None:
    points = strand.points(np.linspace(0.0, 1.0, 2001))
    np.testing.assert_allclose(points[0], strand.start, atol=1e-12)
    np.testing.assert_allclose(points[-1], strand.end, atol=1e-9)
    arcs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.all(arcs <= strand.length / 2000 * (1.0 + 1e-9))
    assert arcs.sum() == pytest.approx(float(strand.length), rel=2e-3)


@given(strands(), st.floats(0.001, 2.0))
def test_end_forces_carry_the_weight_and_pull_along_the_strand(
    strand: Catenaries, mass: float
) -> None:
    at_start, at_end = strand.end_forces(mass)
    weight = mass * STANDARD_GRAVITY * float(strand.length)
    largest = np.linalg.norm(at_start) + np.linalg.norm(at_end)
    np.testing.assert_allclose(at_start + at_end, weight * strand.down, atol=1e-9 * largest)
    horizontal, start_size, end_size = strand.tension(mass)
    assert np.linalg.norm(at_start) == pytest.approx(float(start_size), rel=1e-9)
    assert np.linalg.norm(at_end) == pytest.approx(float(end_size), rel=1e-9)
    assert horizontal <= min(start_size, end_size)


@given(strands())
def test_the_lowest_point_is_lowest(strand: Catenaries) -> None:
    depths = strand.points(np.linspace(0.0, 1.0, 501)) @ strand.down
    assert strand.lowest() @ strand.down >= depths.max() - 1e-9


@given(strands())
def test_a_reversed_strand_is_the_same_strand(strand: Catenaries) -> None:
    back = solve_catenaries(strand.end, strand.start, strand.length, down=strand.down)
    fractions = np.linspace(0.0, 1.0, 9)
    scale = float(strand.length)
    np.testing.assert_allclose(
        back.points(1.0 - fractions), strand.points(fractions), atol=2e-9 * scale
    )


@given(strands(), st.floats(-3.0, 3.0), directions)
def test_tilted_gravity_is_a_rotation(strand: Catenaries, angle: float, axis: np.ndarray) -> None:
    axis = axis / np.linalg.norm(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    turned = solve_catenaries(
        turn @ strand.start, turn @ strand.end, strand.length, down=turn @ (2.0 * strand.down)
    )
    fractions = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(
        turned.points(fractions),
        strand.points(fractions) @ turn.T,
        atol=1e-6 * float(strand.length),
    )


@given(strands(), st.floats(0.0, 1.0))
def test_points_over_the_span_lie_on_the_strand(strand: Catenaries, fraction: float) -> None:
    if strand.span < 0.05 * strand.length:
        return  # a fraction of a tiny span says next to nothing about where on the strand
    point = strand.at_span(fraction)
    across = (point - strand.start) @ strand.heading
    assert across == pytest.approx(fraction * float(strand.span), abs=1e-9)
    dense = strand.points(np.linspace(0.0, 1.0, 4001))
    assert np.linalg.norm(dense - point, axis=1).min() <= strand.length / 8000 * 1.01


@given(strands())
def test_sag_is_the_deepest_drop_below_the_chord(strand: Catenaries) -> None:
    if strand.span < 0.05 * strand.length:
        return
    fractions = np.linspace(0.0, 1.0, 2001)
    offsets = np.array([strand.at_span(f) for f in fractions[::20]]) - strand.start
    drops = offsets @ strand.down + strand.rise * fractions[::20]
    sag = float(strand.sag())
    assert drops.max() <= sag * (1.0 + 1e-9) + 1e-9
    assert drops.max() >= 0.9 * sag


@given(st.floats(0.01, 50.0), st.floats(-5.0, 3.0).map(lambda v: 10.0**v), st.floats(-20.0, 20.0))
def test_length_and_sag_invert_each_other(span: float, relative: float, rise: float) -> None:
    sag = relative * span
    length = float(length_for_sag(span, sag, rise))
    slack = length / float(np.hypot(span, rise)) - 1.0
    if slack < 1e-9:
        return  # the length no longer holds the sag's digits
    assert float(sag_for_length(span, length, rise)) == pytest.approx(sag, rel=1e-14 / slack + 1e-9)


@given(
    st.floats(0.1, 20.0),
    st.floats(-3.0, 1.5).map(lambda v: 10.0**v),
    st.floats(0.02, 0.98),
    st.floats(-10.0, 10.0),
)
def test_the_sag_for_a_drop_has_that_drop(
    span: float, relative: float, fraction: float, rise: float
) -> None:
    drop = relative * span
    sag = float(sag_for_drop(span, drop, fraction, rise))
    assert sag >= drop * (1.0 - 1e-9)
    length = float(length_for_sag(span, sag, rise))
    slack = length / float(np.hypot(span, rise)) - 1.0
    if slack < 1e-9:
        return  # the length no longer holds the drop's digits
    point = solve_catenaries(np.zeros(3), [span, 0.0, rise], length).at_span(fraction)
    precision = drop * (1e-14 / slack + 1e-9) + 1e-14 * abs(rise)
    assert rise * fraction - point[2] == pytest.approx(drop, abs=precision)


def test_level_lengths_agree_with_the_papers_formula() -> None:
    span, sag = 5.0, 2.0
    length = float(length_for_sag(span, sag))
    # s² + h² relation of a level catenary: a = (ℓ²/4 − h²) / 2h, then sag from a alone.
    a = (length**2 / 4.0 - sag**2) / (2.0 * sag)
    assert a * (np.cosh(span / 2.0 / a) - 1.0) == pytest.approx(sag, rel=1e-12)


@pytest.mark.parametrize(
    ("span", "sag"), [(0.0, 1.0), (-1.0, 1.0), (1.0, -0.1), (1.0, np.nan), (np.nan, 1.0)]
)
def test_impossible_sags_are_refused(span: float, sag: float) -> None:
    with pytest.raises(ValueError, match="span must be positive, a sag not negative"):
        length_for_sag(span, sag)


def test_no_sag_is_the_chord() -> None:
    assert length_for_sag(3.0, 0.0, 4.0) == pytest.approx(5.0, rel=1e-15)


@settings(max_examples=25)
@given(st.floats(1e-9, 600.0))
def test_half_angles_solve_their_equation(x: float) -> None:
    mpmath.mp.dps = 40
    ratio = mpmath.sinh(mpmath.mpf(x)) / mpmath.mpf(x)
    found = solve_half_angle(float(mpmath.log(ratio)))
    assert found == pytest.approx(x, rel=5e-16)


@given(strands())
def test_a_strand_begins_exactly_at_its_start(strand: Catenaries) -> None:
    np.testing.assert_array_equal(strand.points([0.0, 1.0])[0], strand.start)
