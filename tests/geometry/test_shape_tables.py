"""Tables of sensitivity and of second derivatives against a catenary in 40 digits."""

import mpmath
import numpy as np
import pytest
from scipy.optimize import minimize

from swarm.geometry import sensitivity
from swarm.geometry.catenary import solve_catenaries
from swarm.geometry.sensitivity import (
    BOTH_ENDS,
    FAR_END,
    NEAR_END,
    Nodes,
    curvature_table,
    kept,
    sensitivity_tables,
)

NARROW = (0.053, 18.0), (0.051, 4.0), (0.06, 0.0), (0.2, 71.0), (0.9, 86.5), (0.97, 60.0)
"""Chord over length and elevation, degrees: narrow bends, and strands near taut."""


def exact(end, fractions):
    """Points (k, 3) of a strand of length 1 from the origin to ``end``."""
    ahead, north, rise = end
    span = mpmath.hypot(ahead, north)
    stretch = mpmath.sqrt(1 - rise**2) / span
    guess = mpmath.sqrt(6 * (stretch - 1)) if stretch < 3 else mpmath.log(2 * stretch) * 1.3
    x = mpmath.findroot(lambda x: mpmath.log(mpmath.sinh(x) / x) - mpmath.log(stretch), guess)
    a, first = span / (2 * x), mpmath.atanh(rise) - x
    points = []
    for fraction in fractions:
        theta = mpmath.asinh(mpmath.sinh(first) + fraction / a)
        along = a * (theta - first) / span
        up = a * (mpmath.cosh(theta) - mpmath.cosh(first))
        points.append([along * ahead, along * north, up])
    return np.array(points, dtype=object)


def derivatives(end, fractions):
    """Jacobians (k, 3, 3) by the end, and second derivatives (k, d) along directions (d, 3)."""
    with mpmath.workdps(40):
        step = mpmath.mpf(10) ** -12
        end = np.array([mpmath.mpf(float(each)) for each in end], dtype=object)
        still = exact(end, fractions)
        columns, second = [], []
        for k, direction in enumerate([*np.eye(3), *DIRECTIONS]):
            moved = np.array([step * mpmath.mpf(float(each)) for each in direction], dtype=object)
            ahead, back = exact(end + moved, fractions), exact(end - moved, fractions)
            if k < 3:
                columns.append(((ahead - back) / (2 * step)).astype(float))
            else:
                second.append(((ahead - 2 * still + back) / step**2).astype(float))
    return np.stack(columns, axis=-1), np.linalg.norm(np.stack(second, axis=1), axis=-1)


DIRECTIONS = np.array(
    [
        (np.cos(g) * np.cos(a), np.sin(g), np.cos(g) * np.sin(a))
        for g in (0.0, 0.5, 1.0, 0.5 * np.pi)
        for a in np.linspace(0.0, np.pi, 8, endpoint=False)
    ]
)


def shape(ratio, degrees):
    """The end of a strand of length 1, and fractions along it, most of them at its bend."""
    steep = np.radians(degrees)
    end = ratio * np.array([np.cos(steep), 0.0, np.sin(steep)])
    strand = solve_catenaries(np.zeros(3), end, 1.0)
    bend = float(strand.lowest_fraction) + float(strand.parameter) * np.linspace(-1.0, 1.0, 7)
    return end, np.clip(np.concatenate([bend, np.linspace(0.05, 0.95, 5)]), 0.01, 0.99)


def norms_of(jacobian):
    """Norms of the horizontal rows and of the vertical one, each (k,)."""
    across = [np.linalg.norm(each[:2], 2) for each in jacobian]
    return np.array(across), np.linalg.norm(jacobian[:, 2], axis=1)


@pytest.mark.parametrize("degrees", [pytest.param(1, id="up"), pytest.param(-1, id="down")])
@pytest.mark.parametrize("ratio_and_elevation", NARROW)
def test_no_exact_derivative_exceeds_the_tables(ratio_and_elevation, degrees):
    ratio, elevation = ratio_and_elevation
    end, fractions = shape(ratio, degrees * elevation)
    by_end, second = derivatives(end, fractions)
    tables, pieces = sensitivity.sensitivity_tables(), 64 + (64 * fractions).astype(int)
    far, near = norms_of(by_end), norms_of(np.eye(3) - by_end)
    for ends, norms in (
        (FAR_END, far),
        (NEAR_END, near),
        (BOTH_ENDS, (far[0] + near[0], far[1] + near[1])),
    ):
        bound = tables.largest(ratio, 0.0, np.sin(np.radians(elevation)), ends, pieces)
        for largest, norm in zip(bound, norms, strict=True):
            assert (norm <= largest).all()
    count = len(fractions)
    found = sensitivity.linear_response(
        solve_catenaries(np.zeros(3), np.tile(end, (count, 1)), np.ones(count)),
        fractions, np.full(count, FAR_END), np.tile([0.0, 0.0, 1.0], (count, 1)),
        (fractions, fractions), np.zeros(count),
    )  # fmt: skip
    assert (second.max(axis=1)[found.known] <= found.curvature[found.known]).all()
    # The compiled figures, of which the tables are made, are exact.
    assert figures(ratio, np.radians(abs(elevation)), fractions if degrees > 0 else 1 - fractions)[
        2
    ] == pytest.approx(second.max(axis=1) * abs(end[0]), rel=1e-6)


def figures(ratio, elevation, fractions):
    """Norms (2, k) of A and B summed, by direction, and second derivatives (k,) times span."""
    end = ratio * np.array([np.cos(elevation), 0.0, np.sin(elevation)])
    strand = solve_catenaries(np.zeros(3), end, 1.0)
    slopes = float(strand.slope) + np.array([0.0, *fractions, 1.0]) / float(strand.parameter)
    angles = np.arcsinh(slopes)[None, None]
    nodes = Nodes(np.array([ratio]), np.zeros(1), angles, angles)
    norms, second = np.empty((2, 2, *angles.shape)), np.empty(angles.shape)
    sensitivity._write_norms(nodes, norms)
    directions = np.ascontiguousarray(DIRECTIONS[:, [0, 2, 1]])
    memory = np.empty((len(directions), 6))
    sensitivity._write_second(nodes, directions, memory, second)
    both = norms.sum(axis=1)[:, 0, 0, 1:-1]
    return *both, second[0, 0, 1:-1]


def shares(point):
    """Largest figures of a shape at a point over its tables: ratio, elevation, share of θ."""
    ratio, elevation, share = point
    if not (0.0 < ratio < 0.9989 and 0.0 <= elevation < 0.5 * np.pi and 0.0 < share < 1.0):
        return [0.0]
    end = ratio * np.array([np.cos(elevation), 0.0, np.sin(elevation)])
    strand = solve_catenaries(np.zeros(3), end, 1.0)
    angle = np.arcsinh(float(strand.slope)) + 2.0 * share * float(strand.half_angle)
    fraction = (np.sinh(angle) - float(strand.slope)) * float(strand.parameter)
    fraction = min(max(fraction, 0.0), 1.0 - 1e-12)
    found = figures(ratio, elevation, [fraction])
    bounds = sensitivity.sensitivity_tables().largest(
        ratio, 0.0, np.sin(elevation), BOTH_ENDS, 64 + int(64 * fraction)
    )
    over = [float(norm[0] / bound) for norm, bound in zip(found, bounds, strict=False)]
    if end[0] > 0.0501 and elevation < np.radians(88.0):
        table = sensitivity.curvature_table()
        band = sensitivity.find_class(np.sin(elevation), sensitivity._BAND_SINES)
        column = int(np.log1p(-ratio) * sensitivity._COLUMNS)
        over.append(float(found[2][0] / table[band, column, int(16 * fraction)]))
    return over


@pytest.mark.parametrize(
    ("begins", "steps"), [(6, 60), pytest.param(400, 200, marks=pytest.mark.full)]
)
def test_a_search_for_shapes_beyond_the_tables_finds_none(begins, steps):
    rng = np.random.default_rng(begins)
    largest = 0.0
    for k in range(begins):
        ratio = rng.choice([10.0 ** rng.uniform(-6, 0), 1.0 - 10.0 ** rng.uniform(-3, -0.3)])
        steep = rng.choice([rng.uniform(0, 90), 90 - 10.0 ** rng.uniform(-6, 1), 20, 60, 76])
        begin = [min(ratio, 0.998), np.radians(steep) - 1e-9, rng.uniform()]
        figure = k % 3

        def less(point, figure=figure):
            over = shares(point)
            return -over[figure] if figure < len(over) else 0.0

        found = minimize(less, begin, method="Nelder-Mead", options={"maxiter": steps})
        largest = max(largest, -found.fun)
        assert max(shares(found.x)) <= 1.0
    assert largest > 0.9


def test_a_table_is_computed_once_and_again_where_it_is_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    computed = []

    def table() -> np.ndarray:
        computed.append(1)
        return np.arange(6.0).reshape(2, 3)

    def read() -> int:
        assert np.array_equal(kept("some", table), table())
        return len(computed)

    assert read() == 2
    assert read() == 3
    (file,) = tmp_path.rglob("some.table")
    file.write_bytes(file.read_bytes()[:-1] + b"\0")
    assert read() == 5
    assert read() == 6
    file.unlink()
    file.mkdir()
    assert read() == 8


def test_the_kept_tables_are_those_that_their_sources_compute():
    assert np.array_equal(sensitivity_tables().bounds, sensitivity._bounds())
    assert np.array_equal(curvature_table(), sensitivity._curvatures())
