"""The swinging cable against small oscillations of the literature, energy, and the catenary."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from swarm.geometry.catenary import (
    STANDARD_GRAVITY,
    OverStretched,
    length_for_sag,
    solve_catenaries,
)
from swarm.geometry.lumped_mass import Strands, SwingModel, cable_model, hang_links
from tests.geometry.swinging import stray, swing

STILL = SwingModel(links=24, step=0.004, normal_drag=0.0)
"""Without air: an oscillation is not damped."""

AIR = cable_model(0.012, 0.006)
"""The cable of the default missions."""

MOVING = 0.4
"""Seconds: short against the periods that are measured, long against those of single links."""


def period(signal: np.ndarray, step: float) -> float:
    """Period of the strongest oscillation: the peak of the padded spectrum of a windowed signal."""
    windowed = np.hanning(len(signal)) * (signal - signal.mean())
    spectrum = np.abs(np.fft.rfft(windowed, 64 * len(signal)))
    return float(64 * len(signal) * step / spectrum.argmax())


def displaced(span: float, length: float, offset: np.ndarray, duration: float) -> np.ndarray:
    """Joints (k, links + 1, 3) of a strand after both ends were moved by ``offset`` in 0.4 s."""
    time = np.arange(0.0, duration, STILL.step)
    share = np.clip(time / MOVING, 0.0, 1.0)[:, None, None]
    ends = np.zeros((len(time), 2, 3))
    ends[:, 1, 0] = span
    ends[:, :, 2] = 20.0
    ends += offset * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return swing(ends, np.array([length]), STILL)[round(MOVING / STILL.step) :, 0]


@pytest.mark.parametrize("sag", [0.1, 0.3, 0.6])
def test_a_shallow_strand_swings_sideways_as_irvine_says(sag: float) -> None:
    # Irvine, Cable Structures (1981), chapter 3: out of plane, ω = (π/l)·√(H/m) with H = m·g·l² / 8d
    span = 4.0
    joints = displaced(span, float(length_for_sag(span, sag)), np.array([0.0, 0.002, 0.0]), 12.0)
    expected = 2.0 * math.pi / (math.pi * math.sqrt(STANDARD_GRAVITY / (8.0 * sag)))
    assert period(joints[:, 12, 1], STILL.step) == pytest.approx(expected, rel=0.02)


def test_a_shallow_strand_sways_in_its_plane_as_irvine_says() -> None:
    # Irvine, Cable Structures (1981), chapter 3: first antisymmetric mode in plane, twice the lateral frequency
    span, sag = 4.0, 0.2
    joints = displaced(span, float(length_for_sag(span, sag)), np.array([0.002, 0.0, 0.0]), 8.0)
    expected = math.pi / (math.pi * math.sqrt(STANDARD_GRAVITY / (8.0 * sag)))
    quarter = joints[:, 6, 2] - joints[:, 18, 2]
    assert period(quarter, STILL.step) == pytest.approx(expected, rel=0.03)


def test_a_folded_strand_swings_as_a_hanging_chain() -> None:
    # both ends in one place: ω = 2.4048 / 2 · √(g / L), the first zero of J₀ (Bernoulli 1733)
    sag = 1.5
    joints = displaced(1e-3, 2.0 * sag, np.array([0.0, 0.002, 0.0]), 20.0)
    expected = 2.0 * math.pi / (0.5 * 2.404826 * math.sqrt(STANDARD_GRAVITY / sag))
    assert period(joints[:, 12, 1], STILL.step) == pytest.approx(expected, rel=0.02)


@settings(deadline=None, max_examples=20)
@given(span=st.floats(0.2, 6.0), rise=st.floats(-2.0, 2.0), slack=st.floats(0.02, 1.0))
@example(span=0.25, rise=2.0, slack=0.75)
@example(span=0.25, rise=2.0, slack=0.875)
def test_a_strand_at_rest_stays_on_its_catenary(span: float, rise: float, slack: float) -> None:
    length = math.hypot(span, rise) * (1.0 + slack)
    link = length / STILL.links
    ends = np.tile(np.array([[0.0, 0.0, 9.0], [span, 0.0, 9.0 + rise]]), (500, 1, 1))
    joints = swing(ends, np.array([length]), STILL, every=50)
    # a polygon is off by l²/8a of a curve of radius a, and where the curve turns over within a link
    # by half a link at most, since a joint is that far from where it turns
    radius = float(solve_catenaries(ends[0, 0], ends[0, 1], length).parameter)
    allowed = link * min(0.5, 0.125 * link / radius)
    assert stray(joints, ends[::50], np.array([length])).max() < allowed
    if span >= link:
        assert np.abs(joints - joints[0]).max() < 1e-9, "it does not move at all"


@settings(deadline=None, max_examples=50)
@given(
    span=st.floats(1e-3, 6.0),
    rise=st.floats(-3.0, 3.0),
    slack=st.floats(1e-4, 5.0),
    links=st.sampled_from([8, 24, 48]),
)
def test_links_at_rest_have_their_length_and_balance_their_tensions(
    span: float, rise: float, slack: float, links: int
) -> None:
    length = max(math.hypot(span, rise), 1e-3) * (1.0 + slack)
    start, end = (
        np.array([1.0, 2.0, 9.0]),
        np.array([1.0 + 0.6 * span, 2.0 - 0.8 * span, 9.0 + rise]),
    )
    joints = np.empty((links + 1, 3))
    closed = hang_links(start, end, length, joints)
    assert closed or span < length / links
    if closed:
        sizes = np.linalg.norm(np.diff(joints, axis=0), axis=1)
        assert sizes == pytest.approx(length / links, rel=1e-6)
        model = replace(STILL, links=links)
        strands = Strands.whole_chain(np.array([length]), model)
        state = strands.at_rest(np.stack([start, end]))
        assert np.array_equal(state[:, 0], [joints, joints])
        along = np.diff(joints, axis=0)
        # equal weights at the joints: slopes that rise by equal steps, over the level tension
        slopes = along[:, 2] / np.hypot(along[:, 0], along[:, 1])
        assert np.diff(slopes) == pytest.approx(np.diff(slopes).mean(), rel=1e-3)


@settings(deadline=None, max_examples=15)
@given(
    offset=st.tuples(*[st.floats(-0.05, 0.05)] * 3),
    slack=st.floats(0.05, 0.6),
)
def test_energy_is_kept_without_air_and_links_keep_their_length(
    offset: tuple[float, float, float], slack: float
) -> None:
    length = 3.0 * (1.0 + slack)
    joints = displaced(3.0, length, np.array(offset), 4.0)
    links = np.linalg.norm(np.diff(joints, axis=1), axis=2)
    assert np.abs(links - length / 24).max() < 1e-8
    velocity = (joints[2:, 1:-1] - joints[:-2, 1:-1]) / (2.0 * STILL.step)
    kinetic = 0.5 * (velocity**2).sum(axis=(1, 2))
    energy = kinetic + STANDARD_GRAVITY * joints[1:-1, 1:-1, 2].sum(axis=1)
    first, last = energy[:200].mean(), energy[-200:].mean()
    assert abs(last - first) < 0.01 * kinetic.max() + 1e-7


def test_drag_takes_energy_and_wind_leans_the_strand() -> None:
    length = float(length_for_sag(4.0, 0.8))
    ends = np.tile(np.array([[0.0, 0.0, 9.0], [4.0, 0.0, 9.0]]), (20000, 1, 1))
    model = SwingModel(24, 0.004, normal_drag=0.3, wind=(0.0, 3.0, 0.0))
    joints = swing(ends, np.array([length]), model, every=100)[-1, 0]
    # at rest in the wind: drag on a strand across it, over its weight
    middle = solve_catenaries(
        ends[0, 0], ends[0, 1], length, down=_leaning(0.3 * 3.0**2 / STANDARD_GRAVITY)
    ).points(np.array([0.5]))[0]
    assert joints[12] == pytest.approx(middle, abs=0.02)


def _leaning(ratio: float) -> np.ndarray:
    return np.array([0.0, ratio, -1.0]) / math.hypot(1.0, ratio)


def test_a_strand_longer_than_its_chord_only() -> None:
    ends = np.zeros((10, 2, 3))
    ends[:, 1, 0] = 2.0
    with pytest.raises(OverStretched, match="its ends are 2 m apart"):
        swing(ends, np.array([1.9]), STILL)
    ends[5:, 1, 0] = 3.0
    joints = swing(ends, np.array([2.5]), STILL)
    assert np.isnan(joints[-1]).any()
    assert np.isinf(stray(joints, ends, np.array([2.5]))[-1])


def test_results_do_not_depend_on_samples_kept_or_on_other_strands() -> None:
    time = np.arange(400) * STILL.step
    ends = np.zeros((400, 3, 3))
    ends[:, :, 0] = [0.0, 2.0, 4.5]
    ends[:, 1, 1] = 0.3 * np.sin(time)
    lengths = np.array([2.6, 3.0])
    whole = swing(ends, lengths, STILL)
    assert np.array_equal(whole[::10], swing(ends, lengths, STILL, every=10))
    alone = swing(np.ascontiguousarray(ends[:, 1:]), lengths[1:], STILL)
    assert np.array_equal(whole[:, 1:], alone)
    chosen = Strands(np.array([1]), lengths[1:], STILL)
    states = chosen.swing_on(chosen.at_rest(ends[0]), ends, every=10)
    assert np.array_equal(whole[::10, 1:], states[:, 1])
    assert np.array_equal(stray(whole, ends, lengths)[:, 1:], chosen.strays(whole[:, 1:], ends))


def test_few_links_swing_by_their_own_length_where_the_cable_runs_through_a_narrow_bend() -> None:
    # one end of a deep and narrow strand rises by 4 m in 16 s: each link turns over at the bottom
    def swung(links: int, step: float) -> float:
        model = replace(AIR, links=links, step=step)
        share = np.clip(np.arange(0.0, 20.0, step) / 16.0, 0.0, 1.0)
        ends, length, every = np.zeros((len(share), 2, 3)), np.array([12.5]), round(0.1 / step)
        ends[:, 1, 0] = 1.5
        ends[:, 1, 2] = 4.0 * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        return float(stray(swing(ends, length, model, every), ends[::every], length).max())

    assert swung(24, 0.02) == pytest.approx(swung(24, 0.01), rel=0.01)  # not for the step
    assert swung(24, 0.02) > 0.15
    assert swung(48, 0.01) < 0.04
    assert swung(96, 0.005) < 0.01
