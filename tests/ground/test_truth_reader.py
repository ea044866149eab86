"""Ground truth in the place of reports, on the clock of the record."""

import json

import numpy as np
import pytest

from swarm.errors import InputError
from swarm.flight.tlog import KnownFrames, Replayed
from swarm.flight.trace import Trace
from swarm.ground.record_reader import true_trace
from swarm.mavlink.frames import Frames

START = 1_800_000_000.0
"""Wall clock at flight time zero."""


def flown(systems=(1, 2)):
    """Return a log that begins 3 s after the flight's time zero, with reports that are all 0."""
    n, time = len(systems), np.array([0.0, 1.0, 2.0, 3.0])
    trace = Trace(time, time, np.zeros((4, n, 3)), np.ones((4, n, 3)), ("fold",) * 4)
    frames = Frames(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))
    return Replayed(
        trace, START + 3.0, 0.0, KnownFrames(systems, frames, np.zeros(n)), (), {}, {}, 0
    )


def recorded(folder, lines):
    """Write a record whose flight began 40 s after its world."""
    (folder / "versions.json").write_text(json.dumps({"start_time": START, "world_start": 40.0}))
    (folder / "truth.jsonl").write_text("\n".join(lines))


def moment(time, *places, ids=(2, 1)):
    return json.dumps({"time": time, "ids": ids, "position": places})


def test_true_positions_have_the_time_of_the_record_and_the_order_of_the_cable(tmp_path):
    second, first = [0.0, 5.0, 1.0], [1.0, 0.0, 1.0]
    lines = [
        moment(44.0, second, first),  # flight time 4, time 1 of the trace
        json.dumps({"record": "events", "kind": "grabbed"}),
        moment(46.0, second, [3.0, 0.0, 1.0]),
        '{"time": 47',
    ]
    recorded(tmp_path, lines)
    trace = true_trace(tmp_path, flown())
    assert np.isnan(trace.position[0]).all()
    assert trace.position[1:, 0] == pytest.approx(
        np.array([[1.0, 0.0, 1.0], [2.0, 0.0, 1.0], [3.0, 0.0, 1.0]])
    )
    assert (trace.position[1:, 1] == second).all()
    assert (trace.setpoint == 1.0).all()


def test_a_record_without_truth_of_its_vehicles_is_named(tmp_path):
    with pytest.raises(InputError, match=r"truth\.jsonl"):
        true_trace(tmp_path, flown())
    place = [0.0, 0.0, 1.0]
    recorded(tmp_path, [moment(40.0 + k, place, place) for k in (1, 2)])
    with pytest.raises(InputError) as caught:
        true_trace(tmp_path, flown((1, 2, 7)))
    assert str(caught.value) == f"{tmp_path / 'truth.jsonl'}: expected vehicles 7, got 2, 1"
    recorded(tmp_path, [moment(41.0, place, place), "{", moment(42.0, place, place)])
    with pytest.raises(InputError) as caught:
        true_trace(tmp_path, flown())
    assert str(caught.value) == f"{tmp_path / 'truth.jsonl'}:2: expected ground truth"
