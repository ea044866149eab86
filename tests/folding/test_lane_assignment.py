"""Initial chords: the preferred ones, but long enough that loops do not meet on the floor."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from swarm.folding.lane_assignment import initial_chords
from swarm.folding.margins import Margins

MARGINS = Margins(
    cable=0.18, vehicle=1.0, downwash=1.0, vehicle_cable=0.4, tracking=0.1, radius=0.2,
    grip_offset=0.1,
)  # fmt: skip
STEP = 0.6


@given(st.lists(st.floats(2.5, 16.0), min_size=3, max_size=20), st.randoms(use_true_random=False))
def test_segments_do_not_reach_across_a_short_segment(lengths, random):
    lengths = np.array(lengths)
    stops = np.array([random.uniform(1.0, 5.0) for _ in lengths])
    chords = initial_chords(lengths, stops, MARGINS, STEP)
    steps = (chords - stops) / STEP
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert (chords <= np.maximum(0.985 * lengths - 0.2, 0.79 * lengths + 0.5 * STEP + 1e-9)).all()
    beyond = 0.5 * (lengths - chords)
    for k in range(1, len(lengths) - 1):
        between = chords[k] - beyond[k - 1] - beyond[k + 1]
        longest = chords + STEP > 0.985 * lengths - 0.25
        assert between >= 0.18 + 0.2 or longest[k - 1 : k + 2].all()


def test_segments_of_equal_length_begin_with_the_preferred_chord():
    lengths = np.full(8, 4.0)
    chords = initial_chords(lengths, np.full(7 + 1, 2.2), MARGINS, STEP)
    assert np.abs(chords - 0.79 * lengths).max() <= 0.5 * STEP
