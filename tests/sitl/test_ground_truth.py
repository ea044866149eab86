"""The emulator and the ground station together, judged by ground truth."""

import numpy as np
import pytest

from sitl import Emulator
from swarm.flight.conductor import Conductor
from swarm.flight.world import emulated_world
from swarm.mission.fleet import emulated_fleet
from swarm.simulation.loop import Callbacks, simulate_flight
from tests.network import small_plan


@pytest.mark.slow
def test_true_positions_follow_the_plan() -> None:
    """Origins are some 30 m away, in each autopilot's local metres: 0.3 % of that is 9 cm."""
    flight_plan = small_plan()
    fleet = emulated_fleet(flight_plan.plan.vehicles, ("px4", "ardupilot"), seed=1)
    world = emulated_world(flight_plan.plan, fleet, with_cable=True, seed=1)
    misses = []

    def observe(conductor: Conductor, emulator: Emulator, now: float) -> None:
        if conductor.stage == "execute" and round(now * 20) % 10 == 0:
            misses.append(emulator.truth().position - conductor.state.streams.setpoint)

    result = simulate_flight(
        flight_plan,
        fleet=fleet,
        world={**world, "projection": "autopilot"},
        callbacks=Callbacks(on_step=observe),
    )
    assert result.outcome.word == "done"
    mean = np.nanmean(np.array(misses), axis=0)
    assert np.abs(mean[:, :2]).max() < 0.03, "GPS and barometer biases are a centimetre"
    assert np.abs(mean[:, 2]).max() < 0.05
