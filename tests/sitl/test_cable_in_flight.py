"""The cable in flight: grabbing, weight, forces on neighbours."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from tests.sitl.client import Ground, world

GRIPPER = dialect.MAV_CMD_DO_GRIPPER


def hung_team(
    count: int = 3,
    integral: float = 0.4,
    mass: float = 0.05,
    slack: float = 0.8,
    model: str = "swinging",
) -> Ground:
    """Return vehicles above their pads with one straight cable with some slack."""
    span = 3.0 + slack
    tied = [span * i for i in range(count)]
    cable = (
        f"{{mass_per_length: {mass}, points: [[0, 0, 0], [{tied[-1]}, 0, 0]], attached: {tied}, "
        f"model: {model}}}"
    )
    ground = Ground(Emulator(world(count, cable, gripper="attached")))
    for i in range(count):
        for name, value in (("MPC_XY_VEL_I_ACC", integral), ("MPC_Z_VEL_I_ACC", 2 * integral)):
            ground.send(
                i + 1,
                dialect.MAVLink_param_set_message(i + 1, 1, name.encode(), value, 9),
            )
    ground.px4_offboard({i + 1: (3.0 * i, 0.0, 4.6) for i in range(count)}, 14.0)
    return ground


def open_grippers(ground: Ground) -> None:
    """Open all grippers: PX4 closes its own as it starts."""
    ground.run(0.5)
    for vehicle in ground.ids:
        ground.command(vehicle, GRIPPER, 1, 0)
    ground.run(1.0)


def test_a_gripper_that_px4_closed_as_it_started_holds_nothing() -> None:
    # real PX4 1.16: `payload_deliverer` commands a grip when it has been configured, and
    # acknowledges another one at once
    ground = Ground(Emulator(world(1, "{points: [[-1, 0, 0], [2.5, 0, 0]]}")))
    ground.run(0.5)
    ground.command(1, GRIPPER, 1, 1)
    ground.run(1.5)
    assert ground.acks(1, GRIPPER)[-1] == 0
    assert not ground.emulator.truth().gripped.any()


def test_a_gripper_grabs_cable_only_within_reach() -> None:
    ground = Ground(Emulator(world(2, "{points: [[-1, 0.05, 0], [2.5, 0.05, 0]]}")))
    open_grippers(ground)
    for vehicle in (1, 2):
        ground.command(vehicle, GRIPPER, 1, 1)
    ground.run(1.5)
    assert ground.acks(1, GRIPPER)[2:] == [5, 0], "in progress, then accepted"
    assert ground.acks(2, GRIPPER)[2:] == [5, 4], "in progress, then failed: half a metre away"
    truth = ground.emulator.truth()
    assert truth.gripped.tolist() == [True, False]
    assert truth.grip_arc[0] == pytest.approx(1.0, abs=1e-6)


def test_the_holders_carry_the_weight_of_the_cable() -> None:
    ground = hung_team(3, model="static")
    truth = ground.emulator.truth()
    assert not truth.strikes
    assert np.isfinite(truth.grip_arc).all()
    force = ground.emulator.rope.forces(ground.emulator.bodies.grip_points(), truth.velocity)
    assert force[:, 2].sum() == pytest.approx(-7.6 * 0.05 * 9.80665, rel=1e-6)
    assert abs(force[:, 0].sum()) < 1e-9
    lengths = np.linalg.norm(np.diff(truth.cable, axis=0), axis=1).sum()
    assert lengths == pytest.approx(7.6, rel=2e-3)


def test_a_swinging_cable_pulls_with_its_weight_on_average() -> None:
    ground = hung_team(3)
    bodies, rope = ground.emulator.bodies, ground.emulator.rope
    forces = []

    def pull(*state: object) -> np.ndarray:
        forces.append(advance(*state))
        return forces[-1]

    advance, rope.forces = rope.forces, pull
    ground.run(10.0, ground.toward({i + 1: (3.0 * i, 0.0, 4.6) for i in range(3)}))
    mean = np.mean(forces, axis=0)
    assert mean[:, 2].sum() == pytest.approx(-7.6 * 0.05 * 9.80665, rel=0.01)
    static = hung_team(3, model="static").emulator.rope
    assert mean == pytest.approx(
        static.forces(bodies.grip_points(), bodies.velocity), abs=0.02 * 7.6 * 0.05 * 9.80665
    )


def test_neighbours_of_a_weak_vehicle_shift_as_statics_predicts() -> None:
    """Without integrators F newtons move a vehicle by F / (m · P_velocity · P_position)."""
    ground = hung_team(3, integral=0.0, mass=0.3, model="static")
    b, rope = ground.emulator.bodies, ground.emulator.rope
    before = b.position.copy()
    pull_before = rope.forces(b.grip_points(), b.velocity)
    b.health[1] = 0.8
    b.refresh()
    places = {i + 1: (3.0 * i, 0.0, 4.6) for i in range(3)}
    ground.run(12.0, ground.toward(places))
    pull_after = rope.forces(b.grip_points(), b.velocity)
    moved = b.position - before
    change = pull_after - pull_before
    assert moved[1, 2] < -0.3
    for neighbour in (0, 2):
        expected = change[neighbour, 0] / (1.5 * 1.8 * 0.95)
        assert abs(expected) > 0.005
        assert moved[neighbour, 0] == pytest.approx(expected, rel=0.05)
        assert moved[neighbour, 2] == pytest.approx(change[neighbour, 2] / (1.5 * 4.0), rel=0.1)


def test_a_released_cable_falls_and_the_vehicle_stays() -> None:
    ground = hung_team(2)
    ground.emulator.rope.release(0)
    ground.emulator.rope.release(1)
    places = {1: (0.0, 0.0, 4.6), 2: (3.0, 0.0, 4.6)}
    ground.run(0.3, ground.toward(places))
    assert ground.emulator.truth().cable[:, 2].max() > 2.0, "it falls; it does not jump"
    ground.run(4.0, ground.toward(places))
    truth = ground.emulator.truth()
    assert truth.cable[:, 2].max() < 0.01
    assert np.abs(truth.position[:, 2] - 4.0).max() < 0.1


@pytest.mark.parametrize("autopilots", [["px4"], ["ardupilot"], ["px4", "ardupilot"]], ids=str)
def test_a_team_picks_up_carries_and_drops_a_cable(autopilots: list[str]) -> None:
    bow = "[0.5, 0.5, 0], [2.5, 0.5, 0], [3, 0, 0], [3.5, 0.5, 0], [5.5, 0.5, 0]"
    cable = f"{{points: [[-0.5, 0, 0], [0, 0, 0], {bow}, [6, 0, 0]]}}"
    ground = Ground(Emulator(world(3, cable, autopilots=autopilots)))
    kinds = {vehicle.id: vehicle.autopilot for vehicle in ground.emulator.world.vehicles}
    open_grippers(ground)
    for vehicle, kind in kinds.items():
        ground.command(vehicle, GRIPPER, 1, 1)
        if kind == "ardupilot":
            ground.command(vehicle, dialect.MAV_CMD_DO_SET_MODE, 1, 4)
            ground.command(vehicle, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 1e5)
    ground.run(1.0)
    assert ground.emulator.truth().gripped.all()
    assert all(ground.acks(vehicle, GRIPPER)[-1] == 0 for vehicle in kinds)
    stands = ground.toward({i: (3.0 * (i - 1), 0.0, 0.6) for i in kinds})
    ground.run(0.5, stands)
    for vehicle, kind in kinds.items():
        if kind == "px4":
            ground.command(vehicle, dialect.MAV_CMD_DO_SET_MODE, 1, 6)
        ground.command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    ground.run(0.3, stands)
    for vehicle, kind in kinds.items():
        if kind == "ardupilot":
            ground.command(vehicle, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.4)
    px4 = {i: (3.0 * (i - 1), 0.0, 3.0) for i, kind in kinds.items() if kind == "px4"}
    ground.run(6.0, ground.toward(px4))
    everywhere = {i: (3.0 * (i - 1) + 1.0, 1.0, 4.0) for i in kinds}
    ground.run(8.0, ground.toward(everywhere))
    truth = ground.emulator.truth()
    wanted = np.array(list(everywhere.values())) - (0.0, 0.0, 0.6)
    assert np.linalg.norm(truth.position - wanted, axis=1).max() < 0.15
    assert truth.gripped.all()
    assert truth.cable[:, 2].max() > 3.0
    assert not truth.strikes
    assert not truth.contacts
    for vehicle in kinds:
        ground.command(vehicle, GRIPPER, 1, 0)
    ground.run(4.0, ground.toward(everywhere))
    truth = ground.emulator.truth()
    assert not truth.gripped.any()
    assert truth.cable[:, 2].max() < 0.01


def test_a_repeated_gripper_command_does_not_restart_the_movement() -> None:
    for autopilot in ("px4", "ardupilot"):
        ground = Ground(
            Emulator(world(1, "{points: [[-1, 0, 0], [2, 0, 0]]}", autopilot=autopilot))
        )
        open_grippers(ground)
        for _ in range(5):
            ground.command(1, GRIPPER, 1, 1)
            ground.run(0.2)
        assert ground.acks(1, GRIPPER)[-1] in {0, 5}
        assert ground.acks(1, GRIPPER).count(0) >= 2
        assert ground.emulator.truth().gripped.all()
