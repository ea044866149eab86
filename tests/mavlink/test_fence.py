"""The fence of one vehicle: upload, read back and clear, with both emulated autopilots."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from sitl.emulator import Emulator
from sitl.world import default_world
from swarm.mavlink.fence import Fence, FenceItem, polygon, same_fence
from swarm.mavlink.packets import Decoder, Encoder
from swarm.mavlink.vehicle import Vehicle

STEP = 0.05
SQUARE = polygon([(47.4, 8.5), (47.4, 8.6), (47.5, 8.6), (47.5, 8.5)])
PLACES = st.tuples(st.floats(-80.0, 80.0), st.floats(-179.0, 179.0))


class Wire:
    """A fence and an emulated vehicle, on a link that loses packets both ways."""

    def __init__(self, kind, loss=0.0, seed=0):
        self.emulator = Emulator(default_world(1, [kind]))
        self.rng, self.loss = np.random.default_rng(seed), loss
        self.encoder, self.decoder, self.vehicle = Encoder(), Decoder(), Vehicle(1)
        self.fence = self.vehicle.fence
        self.now, self.sent = 0.0, []

    def run(self, most=60.0):
        """Exchange packets until the fence is not busy; return the duration."""
        end, begin = self.now + most, self.now
        while self.fence.busy and self.now < end:
            for message in self.fence.tick(1, 1, self.now):
                self.sent.append(message.get_type())
                data = self.encoder.encode(message)
                if self.rng.random() >= self.loss:
                    self.emulator.receive(1, data, self.now)
            self.now += STEP
            for _, data in self.emulator.step(self.now):
                for packet in self.decoder.feed(data) if self.rng.random() >= self.loss else ():
                    self.vehicle.receive(packet, self.now)
        assert not self.fence.busy
        return self.now - begin


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_fence_is_uploaded_read_back_and_cleared(kind):
    wire = Wire(kind)
    wire.fence.fetch()
    wire.run()
    assert wire.fence.items == ()
    wire.fence.upload(SQUARE)
    assert wire.fence.items is None
    wire.run()
    assert same_fence(wire.fence.items, SQUARE)
    corners = wire.emulator.by_id[1].fence[0].corners
    assert len(corners) == 4
    wire.fence.upload(())
    wire.run()
    assert wire.fence.items == ()
    assert wire.emulator.by_id[1].fence == ()
    assert wire.fence.problem == ""


@settings(max_examples=10, deadline=None)
@given(st.lists(PLACES, min_size=3, max_size=12), st.integers(0, 2**31), st.booleans())
@example([(0.0, 0.0)] * 4, 253, True)  # a packet of ten attempts in a row is lost
def test_lost_packets_do_not_change_a_fence(corners, seed, px4):
    wire = Wire("px4" if px4 else "ardupilot", loss=0.2, seed=seed)
    wire.fence.upload(polygon(corners))
    wire.run(most=400.0)
    if wire.fence.problem:
        assert wire.fence.problem == "does not answer about its fence"
        assert len(set(wire.sent[-10:])) == 1
        assert wire.fence.items is None
    else:
        assert same_fence(wire.fence.items, polygon(corners))


def test_a_silent_vehicle_ends_in_time_with_a_reason():
    wire = Wire("px4", loss=1.0)
    wire.fence.fetch()
    assert wire.run() == pytest.approx(15.0, abs=10 * STEP)
    assert wire.sent == ["MISSION_REQUEST_LIST"] * 10
    assert (wire.fence.items, wire.fence.problem) == (None, "does not answer about its fence")


def test_a_refused_fence_is_a_problem_with_the_reason():
    wire = Wire("px4")
    circle = FenceItem(common.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, 0, (-1.0, 0, 0, 0), 0, 0, 0.0)
    wire.fence.upload([circle])
    wire.run()
    assert (wire.fence.items, wire.fence.problem) == (None, "refused the fence: error")


def test_messages_for_others_and_of_other_lists_are_ignored():
    fence = Fence()
    fence.fetch()
    fence.tick(1, 1, 0.0)
    for target, kind in (
        (254, common.MAV_MISSION_TYPE_FENCE),
        (255, common.MAV_MISSION_TYPE_RALLY),
    ):
        fence.counted(common.MAVLink_mission_count_message(target, 190, 3, kind))
    assert fence.tick(1, 1, 0.1) == []
    fence.counted(
        common.MAVLink_mission_count_message(255, 190, 501, common.MAV_MISSION_TYPE_FENCE)
    )
    assert fence.problem == "reports a fence of 501 items"
    # without a request of ours, an acknowledgement means nothing
    fence.acknowledged(
        common.MAVLink_mission_ack_message(255, 190, 4, common.MAV_MISSION_TYPE_FENCE)
    )
    assert not fence.busy
