"""The bounds of motion against finite differences, finite motions and searches for the worst."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import differential_evolution

from swarm.cable.bounds import (
    ball_bound,
    chord_polygon_error,
    motion_bound,
    shape_sensitivity,
    tilt_bound,
    turning_bound,
)
from swarm.cable.catenary import Catenaries, hang
from swarm.cable.distance import point_polyline

FRACTIONS = np.linspace(0.0, 1.0, 161)


def inclined(ratio: float, inclination: float) -> np.ndarray:
    """Where the other end is, of a strand of length 1 from the origin."""
    return ratio * np.array([np.cos(inclination), 0.0, np.sin(inclination)])


def response(end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion (k, 3, 3) of material points per motion of the end, by differences, and normals.

    The start stays; what moving it does follows from moving everything.
    """
    step = 1e-6 * min(1.0, 20.0 * (1.0 - np.linalg.norm(end)))
    ends = end + step * np.concatenate([np.eye(3), -np.eye(3)])
    points = hang(np.zeros(3), ends, 1.0).points(FRACTIONS)
    derivative = np.moveaxis((points[:3] - points[3:]) / (2.0 * step), 0, -1)
    strand = hang(np.zeros(3), end, 1.0)
    slope = strand.slope + FRACTIONS / strand.parameter
    normals = np.stack([-slope, 0.0 * slope, 1.0 + 0.0 * slope], axis=-1)
    return derivative, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def closed_form(strand: Catenaries) -> np.ndarray:
    """J(s) in the plane of the strand, as the module's text has it."""
    slope = strand.slope + FRACTIONS * strand.length / strand.parameter
    angle = np.arcsinh(slope)
    tanh, sech = np.tanh(angle), 1.0 / np.cosh(angle)
    k22, k12 = tanh - tanh[0], sech - sech[0]
    k11 = angle - angle[0] - k22
    stiffness = np.moveaxis(np.array([[k11, k12], [k12, k22]]), (0, 1), (1, 2))
    return stiffness @ np.linalg.inv(stiffness[-1])


SHAPES = [(r, b) for r in (0.05, 0.4, 0.8, 0.95, 0.995) for b in (0.0, 0.4, -1.0, 1.45)]


@pytest.mark.parametrize(("ratio", "inclination"), SHAPES)
def test_the_response_is_the_closed_form(ratio: float, inclination: float) -> None:
    end = inclined(ratio, inclination)
    derivative, _ = response(end)
    strand = hang(np.zeros(3), end, 1.0)
    size = np.abs(derivative).max()
    expected = closed_form(strand)
    np.testing.assert_allclose(derivative[:, ::2, ::2], expected, atol=3e-5 * size)
    share = ((strand.points(FRACTIONS) - strand.start) @ strand.heading) / strand.span
    np.testing.assert_allclose(derivative[:, 1, 1], share, atol=1e-6)
    np.testing.assert_allclose(derivative[:, 1, ::2], 0.0, atol=1e-6)
    assert np.all((share >= -1e-12) & (share <= 1.0 + 1e-12))


@pytest.mark.parametrize(("ratio", "inclination"), SHAPES)
def test_condition_of_the_response_bounds_it(ratio: float, inclination: float) -> None:
    """S ≤ √κ, the part that is proved."""
    strand = hang(np.zeros(3), inclined(ratio, inclination), 1.0)
    angle = np.arcsinh([strand.slope, strand.slope + strand.length / strand.parameter])
    k22, k12 = np.diff(np.tanh(angle))[0], np.diff(1.0 / np.cosh(angle))[0]
    eigenvalues = np.linalg.eigvalsh([[np.diff(angle)[0] - k22, k12], [k12, k22]])
    reflected = 2.0 * closed_form(strand) - np.eye(2)
    largest = np.linalg.norm(reflected, 2, axis=(1, 2)).max()
    assert largest <= np.sqrt(eigenvalues[1] / eigenvalues[0]) * (1.0 + 1e-6)


def greatest(ratio: float, inclination: float) -> tuple[float, float, float]:
    """S, its part across the chord, and the joint response to both ends in a ball; from FDs."""
    derivative, normals = response(inclined(ratio, inclination))
    # Across the strand: its normal in the plane, and the direction out of the plane.
    out = derivative[:, 1, 1]
    row = np.einsum("ki,kij->kj", normals, derivative)
    reflected = 2.0 * row - normals
    chord = inclined(1.0, inclination + np.pi / 2.0)
    weights = np.linspace(0.0, np.pi / 2.0, 19)[:, None]
    both = sum(
        np.hypot(np.cos(weights) * np.linalg.norm(part, axis=1), np.sin(weights) * share)
        for part, share in ((row, out), (normals - row, 1.0 - out))
    )
    return (
        float(np.linalg.norm(reflected, axis=1).max()),
        float(np.abs(reflected @ chord).max()),
        float(both.max()),
    )


def check_sensitivity(ratios: np.ndarray, inclinations: np.ndarray) -> None:
    for ratio in ratios:
        bound = float(shape_sensitivity(ratio, 1.0))
        for inclination in inclinations:
            stretching, across, both = greatest(ratio, inclination)
            assert stretching <= max(1.0 + 1e-4, bound), (ratio, inclination)
            assert both <= np.hypot(1.01, bound), (ratio, inclination)
            assert across <= (1.0 + 1e-4 if ratio <= 0.99 else 1.13), (ratio, inclination)


def test_no_shape_on_a_mesh_responds_more_than_its_bound() -> None:
    check_sensitivity(
        np.concatenate([np.linspace(0.02, 0.98, 13), [0.99, 0.997, 0.9995]]),
        np.concatenate([np.linspace(0.0, 1.5, 9), [1.54, 1.56, 1.57]]),
    )


@pytest.mark.full
def test_no_shape_on_a_fine_mesh_responds_more_than_its_bound() -> None:
    check_sensitivity(
        np.concatenate([np.linspace(0.005, 0.99, 120), 1.0 - 10.0 ** np.linspace(-2, -5, 40)]),
        np.concatenate(
            [np.linspace(0.0, 1.5, 60), np.pi / 2.0 - 10.0 ** np.linspace(-1.2, -5, 40)]
        ),
    )


@pytest.mark.parametrize("ratio", [0.3, 0.75, 0.9, 0.97, 0.985, 0.999])
def test_the_level_strand_attains_the_bound(ratio: float) -> None:
    stretching, _, both = greatest(ratio, 0.0)
    bound = float(shape_sensitivity(ratio, 1.0)) / 1.01
    assert stretching == pytest.approx(max(1.0, bound), rel=1e-4)
    assert both == pytest.approx(np.hypot(1.0, bound), rel=1e-3)


def test_amplification_near_taut_is_what_was_measured() -> None:
    """The sag of a level strand gains 1.7 m per metre of chord at 0.97, and 9.7 m at 0.999."""
    found = 0.5 * shape_sensitivity([0.97, 0.999], 1.0)
    np.testing.assert_allclose(found, [1.7, 9.7], rtol=0.04)


def test_sensitivity_grows_with_the_chord() -> None:
    found = shape_sensitivity(np.linspace(0.0, 0.9999999, 5001), 1.0)
    assert np.all(np.diff(found) > 0.0)
    assert np.isinf(shape_sensitivity([1.0, 2.0], 1.0)).all()
    np.testing.assert_allclose(shape_sensitivity(3.0, 4.0), shape_sensitivity(0.75, 1.0))


def set_distance(first: Catenaries, second: Catenaries) -> float:
    """Greatest distance of a point of either strand from the other, to 0.1 % of their length."""
    some, many = np.linspace(0.0, 1.0, 61), np.linspace(0.0, 1.0, 361)
    return max(
        float(point_polyline(a.points(some), b.points(many)).distance.max())
        for a, b in ((first, second), (second, first))
    )


unit = st.floats(-1.0, 1.0)
vectors = st.tuples(unit, unit, unit).map(np.array)


@st.composite
def motions(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The end of a strand of length 1 from the origin, and displacements of both of its ends."""
    ratio = draw(st.sampled_from([0.05, 0.5, 0.8, 0.93, 0.97]))
    end = inclined(ratio, draw(st.floats(-1.57, 1.57)))
    size = draw(st.sampled_from([0.3, 0.05, 0.005]))
    moved = size * draw(vectors), size * draw(vectors)
    longest = np.linalg.norm(end + moved[1] - moved[0])
    if longest > 0.985:
        moved = tuple(v * 0.3 * (0.985 - ratio) / size for v in moved)
    return end, *moved


@given(motions())
def test_strands_move_no_farther_than_the_bound(motion: tuple[np.ndarray, ...]) -> None:
    end, a, b = motion
    before, after = hang(np.zeros(3), end, 1.0), hang(a, end + b, 1.0)
    chord = max(np.linalg.norm(end), np.linalg.norm(end + b - a))
    bound = motion_bound(np.linalg.norm(a + b) / 2.0, np.linalg.norm(b - a), chord, 1.0)
    assert set_distance(before, after) <= bound + 1e-3


@given(motions())
def test_strands_turn_no_farther_than_the_bound(motion: tuple[np.ndarray, ...]) -> None:
    end, a, b = motion
    share = np.linspace(0.0, 1.0, 400)[:, None]
    chords = end + share * (b - a)
    sizes = np.linalg.norm(chords, axis=1)
    along = np.abs(chords / np.maximum(sizes, 1e-9)[:, None] @ (b - a))
    across = np.sqrt(np.maximum((b - a) @ (b - a) - along**2, 0.0))
    mean = np.linalg.norm(a + b) / 2.0
    bound = turning_bound(mean, along.max(), across.max(), sizes.max(), 1.0)
    assert set_distance(hang(np.zeros(3), end, 1.0), hang(a, end + b, 1.0)) <= bound + 1e-3
    relative = np.linalg.norm(b - a)
    assert bound <= motion_bound(mean, relative, sizes.max(), 1.0) * np.sqrt(2.0) + 1e-12


def test_turning_a_nearly_taut_strand_does_not_whip_it() -> None:
    whipped = motion_bound(0.0, 0.1, 0.98, 1.0)
    turned = turning_bound(0.0, 0.001, 0.1, 0.98, 1.0)
    assert turned < 0.06
    assert whipped > 0.2


@pytest.mark.parametrize("ratio", [0.2, 0.93])
def test_no_displacement_within_the_ball_beats_its_bound(ratio: float) -> None:
    radius = 0.02
    bound = float(ball_bound(radius, ratio, 1.0))

    def off(variables: np.ndarray) -> float:
        end = inclined(ratio, variables[0])
        a, b = (v * radius / max(1.0, np.linalg.norm(v)) for v in variables[1:].reshape(2, 3))
        return -set_distance(hang(np.zeros(3), end, 1.0), hang(a, end + b, 1.0))

    found = differential_evolution(
        off,
        [(0.0, 1.57)] + [(-1.0, 1.0)] * 6,
        maxiter=6,
        popsize=6,
        seed=1,
        polish=False,
        x0=[0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0],
    )
    assert -found.fun <= bound + 2e-4
    assert -found.fun >= 0.6 * bound


def test_a_ball_that_could_pull_the_strand_taut_has_no_bound() -> None:
    assert np.isinf(ball_bound(0.1, 0.8, 1.0))
    assert ball_bound(0.0, 1.0, 1.0) == 0.0
    assert ball_bound(0.1, 0.1, 1.0) == pytest.approx(0.1, rel=0.1)


@given(st.sampled_from([0.1, 0.6, 0.9, 0.98]), st.floats(-1.57, 1.57), st.floats(0.0, 0.6), vectors)
def test_tilting_gravity_moves_no_farther_than_the_bound(
    ratio: float, inclination: float, angle: float, towards: np.ndarray
) -> None:
    sideways = np.array([towards[0], towards[1], 0.0])
    if np.linalg.norm(sideways) < 1e-3:
        return
    sideways *= np.sin(angle) / np.linalg.norm(sideways)
    end = inclined(ratio, inclination)
    still = hang(np.zeros(3), end, 1.0)
    blown = hang(np.zeros(3), end, 1.0, down=sideways - [0.0, 0.0, np.cos(angle)])
    assert set_distance(still, blown) <= tilt_bound(angle, ratio, 1.0) + 1e-3


@given(
    st.floats(0.0, 0.99),
    st.floats(-1.57, 1.57),
    st.sampled_from([1, 2, 5, 16]),
)
def test_polygons_are_as_close_as_they_say(ratio: float, inclination: float, pieces: int) -> None:
    strand = hang(np.zeros(3), inclined(ratio, inclination), 1.0)
    polygon = strand.points(np.linspace(0.0, 1.0, pieces + 1))
    error = float(chord_polygon_error(polygon, 1.0))
    off = point_polyline(strand.points(np.linspace(0.0, 1.0, 801)), polygon).distance.max()
    assert off <= error + 1e-12
    if pieces == 16 and ratio > 0.5 and abs(inclination) < 1.0:
        assert error <= 1.2 * off + 1e-6
