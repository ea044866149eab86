"""Every fault from each of its three sources, in flight, judged by its effects."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator
from sitl.faults import KINDS, SIM_PARAMETERS, Fault, parse_scenario
from tests.sitl.client import Ground, world

INJECT, GRIP, ARM = 420, dialect.MAV_CMD_DO_GRIPPER, dialect.MAV_CMD_COMPONENT_ARM_DISARM
CABLE = "{mass_per_length: 0.02, points: [[0, 0, 0], [7.2, 0, 0]], attached: [0, 3.6, 7.2]}"
PLACES = {i + 1: (3.0 * i, 0.0, 5.0) for i in range(4)}
SCENARIO, PARAMETER, INJECTION, HEALTHY = 1, 2, 3, 4
POSITION = "LOCAL_POSITION_NED"


class Flight:
    """One vehicle of a flight since the start of its fault."""

    def __init__(self, ground: Ground, vehicle: int) -> None:
        self.ground, self.vehicle = ground, vehicle
        self.before = self.position
        self.report = ground.last[vehicle, POSITION]

    @property
    def position(self) -> Any:
        return self.ground.emulator.truth().position[self.vehicle - 1]

    @property
    def height(self) -> float:
        return float(self.position[2])

    @property
    def moved(self) -> float:
        return float(np.linalg.norm(self.position - self.before))

    @property
    def mode(self) -> str:
        events = self.ground.emulator.events
        return [e["mode"] for e in events if e["kind"] == "mode" and e["vehicle"] == self.vehicle][
            -1
        ]

    def last(self, name: str = POSITION) -> Any:
        return self.ground.last[self.vehicle, name]

    @property
    def positions(self) -> list[tuple[float, Any]]:
        """Times and positions that arrived since the fault."""
        log = self.ground.log
        return [
            (t, m) for t, system, m in log if system == self.vehicle and m.get_type() == POSITION
        ]

    @property
    def received(self) -> int:
        return len(self.positions)

    @property
    def order(self) -> list[int]:
        return [m.time_boot_ms for _, m in self.positions]

    @property
    def delays(self) -> Any:
        """Delays of positions after their time stamps."""
        boot = -self.ground.emulator.by_id[self.vehicle].booted_at
        return np.array([t - (m.time_boot_ms * 1e-3 - boot) for t, m in self.positions])

    @property
    def texts(self) -> list[str]:
        return self.ground.texts(self.vehicle)

    @property
    def health(self) -> int:
        return int(self.last("SYS_STATUS").onboard_control_sensors_health)


class Case(NamedTuple):
    """A fault as scenario, parameters and injection; its effect after some seconds."""

    scenario: str
    parameters: dict[str, float]
    injection: tuple[int, ...] | None
    seconds: float
    seen: Callable[[Flight], bool]


CASES: dict[str, Case] = {
    "outage": Case("kind: link, loss: 1", {"SIM_LINK_LOSS": 1}, (105, 1), 3.0,
        lambda f: f.received <= 1 and f.mode == "DESCEND"),
    "outage towards it": Case("kind: link, loss: 1, direction: up",
        {"SIM_LINK_DIR": 1, "SIM_LINK_LOSS": 1}, (105, 1, 1), 3.0,
        lambda f: f.received > 20 and f.mode == "DESCEND"),
    "outage from it": Case("kind: link, loss: 1, direction: down",
        {"SIM_LINK_DIR": 2, "SIM_LINK_LOSS": 1}, (105, 1, 2), 3.0,
        lambda f: f.received <= 1 and f.mode == "OFFBOARD"),
    "bursts": Case("kind: link, loss: 0.5, burst: 0.3",
        {"SIM_LINK_BURST": 0.3, "SIM_LINK_LOSS": 0.5}, (105, 7), 8.0,
        lambda f: 15 < f.received < 65 and max(np.diff(f.order)) >= 300),
    "loss": Case("kind: link, loss: 0.5", {"SIM_UART_LOSS": 50}, None, 8.0,
        lambda f: 20 < f.received < 60),
    "latency and jitter": Case("kind: link, latency: 0.3, jitter: 0.1",
        {"SIM_LINK_DELAY": 0.3, "SIM_LINK_JITTER": 0.1}, (105, 6), 4.0,
        lambda f: np.median(f.delays[10:]) > 0.3 and np.ptp(f.delays[10:]) > 0.04),
    "duplication": Case("kind: link, duplicate: 0.3", {"SIM_LINK_DUP": 0.3}, (105, 3), 8.0,
        lambda f: f.received > 85 and len(set(f.order)) < f.received),
    "reordering": Case("kind: link, reorder: 0.3, jitter: 0.2",
        {"SIM_LINK_REORD": 0.3, "SIM_LINK_JITTER": 0.2}, None, 8.0,
        lambda f: f.order != sorted(f.order)),
    "bandwidth": Case("kind: link, bandwidth: 300", {"SIM_LINK_BANDW": 300}, None, 8.0,
        lambda f: f.delays[-1] > 1.0 and f.received < 75),
    "narrow band": Case("kind: link, bandwidth: 2000", {"SIM_LINK_BANDW": 2000}, (105, 5), 3.0,
        lambda f: getattr(
            f.ground.emulator.injector.down[f.vehicle - 1].fault, "bandwidth", 0) == 2000.0),
    "motor loss": Case("kind: motor_loss", {"SIM_ENGINE_FAIL": 1}, (101, 1), 2.5,
        lambda f: f.height < 2.0),
    "weak thrust": Case("kind: weak_thrust, fraction: 0.7", {"SIM_ENGINE_MUL": 0.7}, (101, 4), 0.8,
        lambda f: 3.0 < f.height < 4.15),
    "battery low": Case("kind: battery, charge: 0.1", {"SIM_BATT_VOLTAGE": 10.17}, (100, 4), 3.0,
        lambda f: "Low battery\t" in f.texts),
    "battery critical": Case("kind: battery, charge: 0.04", {"SIM_BATT_VOLTAGE": 10.0}, (100, 1),
        3.0, lambda f: any(t[:3] in {"Cri", "Eme"} for t in f.texts)),
    "gps jump": Case("kind: gps_jump, offset: [0, 2.0, 0]", {"SIM_GPS1_GLTCH_X": 2 / 111_195},
        (4, 4), 6.0, lambda f: f.moved > 0.5),
    "gps loss": Case("kind: gps_loss", {"SIM_GPS1_ENABLE": 0}, (4, 1), 5.5,
        lambda f: not f.health & 32
        and f.mode == "DESCEND"),
    "position loss": Case("kind: position_loss", {"SIM_POS_LOSS": 1}, (6, 1), 1.5,
        lambda f: f.mode == "DESCEND"),
    "origin reset": Case("kind: origin_reset, offset: [0, 5, 0]", {"SIM_ORIGIN_N": 5.0}, (6, 4),
        0.3, lambda f: np.hypot(*(
            getattr(f.last(), k) - getattr(f.report, k)
            for k in ("x", "y"))) > 4.0),
    "barometer drift": Case("kind: barometer_drift, rate: 0.1", {"SIM_BARO_DRIFT": 0.1}, (3, 4),
        8.0, lambda f: f.height < 4.0),
    "frozen": Case("kind: freeze, duration: 30", {"SIM_FREEZE": 30}, (200, 2), 4.0,
        lambda f: f.received <= 1 and f.height > 4.0),
    "rebooting": Case("kind: reboot", {"SIM_REBOOT": 1}, (200, 7), 4.0,
        lambda f: f.height < 2.5
        and f.last().time_boot_ms
        < f.report.time_boot_ms),
    "pilot": Case("kind: pilot", {"SIM_PILOT": 1}, (104, 4), 1.0, lambda f: f.mode == "POSCTL"),
    "leaves offboard": Case("kind: leave_offboard", {"SIM_LEAVE": 1}, (200, 3), 1.0,
        lambda f: f.mode == "LOITER"),
    "disarms": Case("kind: disarm", {"SIM_DISARM": 1}, (200, 1), 1.5,
        lambda f: f.height < 3.0 and not f.ground.armed(f.vehicle)),
    "believes that it has landed": Case("kind: believes_landed", {"SIM_LANDED": 1}, (7, 4), 4.0,
        lambda f: not f.ground.armed(f.vehicle) and f.height < 1.5),
    "slow clock": Case("kind: slow_clock, fraction: 0.9", {"SIM_CLOCK_MUL": 0.9}, (200, 5), 8.0,
        lambda f: abs(f.last().time_boot_ms
        - f.report.time_boot_ms - 7200) < 150),
}  # fmt: skip


def set_parameters(ground: Ground, vehicle: int, values: dict[str, float]) -> None:
    """Send PARAM_SET with every value as a number."""
    for name, value in values.items():
        mav = ground.mav[vehicle]
        message = dialect.MAVLink_param_set_message(vehicle, 1, name.encode(), value, 9)
        ground.emulator.receive(vehicle, message.pack(mav), ground.now)


def aloft(count: int, cable: str = "", **keys: Any) -> Ground:
    ground = Ground(Emulator(world(count, cable, **keys)))
    ground.px4_offboard({i: PLACES[i] for i in ground.ids}, 7.0)
    assert ground.emulator.truth().position[:, 2].min() > 4.2
    return ground


def start_fault(ground: Ground, vehicle: int, source: int, case: Case) -> None:
    if source == SCENARIO:
        text = f"{{schema: 1, faults: [{{at: 0, vehicle: {vehicle}, {case.scenario}}}]}}"
        for fault in parse_scenario(text):
            ground.emulator.inject(fault)
    elif source == PARAMETER:
        set_parameters(ground, vehicle, case.parameters)
    elif case.injection is not None:
        ground.command(vehicle, INJECT, *case.injection)


@pytest.mark.parametrize("name", CASES)
def test_a_fault_has_the_same_effect_from_every_source(name: str) -> None:
    """Each of three vehicles has another source; the fourth stays healthy."""
    case = CASES[name]
    ground = aloft(4)
    flights = [Flight(ground, vehicle) for vehicle in ground.ids]
    ground.log.clear()
    for source in (SCENARIO, PARAMETER, INJECTION):
        start_fault(ground, source, source, case)
    ground.run(case.seconds, ground.toward(PLACES))
    seen = [case.seen(flight) for flight in flights]
    assert seen == [True, True, case.injection is not None, False]


CARRIED = {
    "slips": Case("kind: gripper_slip", {"SIM_GRIP_FAIL": 3}, (102, 4), 1.0,
        lambda f: f.ground.emulator.truth().gripped.tolist() == [True, False, True]),
    "snag": Case("kind: snag", {"SIM_SNAG_ARC": 3.6}, (201, 2), 2.0,
        lambda f: f.moved < 0.3 and len(f.ground.emulator.truth().chord) == 3),
}  # fmt: skip


@pytest.mark.parametrize("name", CARRIED)
@pytest.mark.parametrize("source", [SCENARIO, PARAMETER, INJECTION])
def test_a_fault_of_a_carried_cable_has_the_same_effect_from_every_source(
    name: str, source: int
) -> None:
    case = CARRIED[name]
    ground = aloft(3, CABLE, gripper="attached")
    flight = Flight(ground, 2)
    start_fault(ground, 2, source, case)
    aside = {i: (x, y + 1.0, z) for i, (x, y, z) in PLACES.items()}
    ground.run(case.seconds, ground.toward(aside))
    assert case.seen(flight)


def test_every_fault_has_a_case_or_a_test() -> None:
    """Tests of grippers and arming are on the ground, those of radios with their failsafes, that of
    headings with the faults' effects.

    Motion capture and a person's hands are in `tests/sitl/test_capture.py`: no vehicle causes them.
    """
    covered = {
        fault.kind
        for case in [*CASES.values(), *CARRIED.values()]
        for fault in parse_scenario(f"{{schema: 1, faults: [{{at: 0, {case.scenario}}}]}}")
    }
    around = {"capture", "handled"}
    own = {"gripper_stuck_open", "gripper_stuck_shut", "refuse_arming", "rc_loss", "wind"}
    own.add("heading")
    assert covered | own | around == set(KINDS)
    injected = {name for name, kind in KINDS.items() if kind.injected}
    assert injected == set(KINDS) - {"wind"} - around


@pytest.mark.parametrize("source", ["parameters", "injection"])
def test_stuck_grippers_and_refused_arming(source: str) -> None:
    cable = "{points: [[-1, 0, 0], [7, 0, 0]]}"
    ground = Ground(Emulator(world(2, cable)))
    ground.run(0.5)
    for vehicle in ground.ids:
        ground.command(vehicle, GRIP, 1, 0)
    ground.run(1.0)
    if source == "parameters":
        set_parameters(ground, 1, {"SIM_GRIP_FAIL": 1, "SIM_ARM_REFUSE": 1})
    else:
        ground.command(1, INJECT, 102, 1)
        ground.command(1, INJECT, 2, 1)
    ground.run(0.1)
    ground.command(1, GRIP, 1, 1)
    ground.command(1, ARM, 1)
    ground.command(2, GRIP, 1, 1)
    ground.run(1.0)
    assert ground.acks(1, GRIP)[-1] == 4
    assert ground.acks(1, ARM) == [1]
    assert ground.emulator.truth().gripped.tolist() == [False, True]
    if source == "parameters":
        set_parameters(ground, 2, {"SIM_GRIP_FAIL": 2})
        set_parameters(ground, 1, {"SIM_GRIP_FAIL": 0, "SIM_ARM_REFUSE": 0})
    else:
        ground.command(2, INJECT, 102, 2)
        ground.command(1, INJECT, 102, 0)
        ground.command(1, INJECT, 2, 0)
    ground.run(0.1)
    ground.command(1, GRIP, 1, 1)
    ground.command(1, ARM, 1)
    ground.command(2, GRIP, 1, 0)
    ground.run(1.0)
    assert ground.acks(1, GRIP)[-1] == 0, "it works again"
    assert ground.acks(1, ARM) == [1, 0]
    assert ground.emulator.truth().gripped.tolist() == [True, True], "one cannot open"


def test_wind_parameters_set_and_end_the_wind() -> None:
    ground = Ground(Emulator(world(1, wind="{steady: [1.0, 0, 0]}")))
    set_parameters(ground, 1, {"SIM_WIND_DIR": 270.0, "SIM_WIND_SPD": 4.0})
    ground.run(0.2)
    assert ground.emulator.bodies.wind[0] == pytest.approx([4.0, 0.0, 0.0], abs=1e-9)
    set_parameters(ground, 1, {"SIM_WIND_SPD": 0.0})
    ground.run(0.2)
    assert ground.emulator.bodies.wind[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_both_autopilots_have_the_sim_parameters(
    autopilot: str,
) -> None:
    ground = Ground(Emulator(world(1, autopilot=autopilot)))
    names = set(ground.emulator.vehicles[0].parameters.names)
    assert set(SIM_PARAMETERS) <= names
    assert max(map(len, SIM_PARAMETERS)) <= 16


def test_a_snag_slides_above_its_friction() -> None:
    def held(friction: str) -> float:
        """Return the distance that the snag has moved after the team has climbed by one metre."""
        ground = aloft(3, CABLE, gripper="attached")
        ground.emulator.inject(
            parse_scenario(f"{{schema: 1, faults: [{{at: 0, kind: snag, arc: 1.8{friction}}}]}}")[0]
        )
        ground.run(0.1, ground.toward(PLACES))
        anchor = ground.emulator.injector.anchors[0]
        start = anchor.position.copy()
        higher = {i: (x, y, z + 2.0) for i, (x, y, z) in PLACES.items()}
        ground.run(6.0, ground.toward(higher))
        return float(np.linalg.norm(anchor.position - start))

    assert held("") == 0.0
    assert held(", friction: 1.0") > 1.0
    assert held(", friction: 60.0") < 0.05


def test_a_snag_falls_with_a_released_cable() -> None:
    ground = aloft(3, CABLE, gripper="attached")
    (snag,) = parse_scenario("{schema: 1, faults: [{at: 0, kind: snag, arc: 1.8}]}")
    ground.emulator.inject(snag)
    ground.run(0.5, ground.toward(PLACES))
    height = ground.emulator.injector.anchors[0].position[2]
    assert height > 1.0
    for index in range(3):
        assert ground.emulator.injector.anchors
        ground.emulator.vehicles[index].environment.release(index)
    ground.run(3.0, ground.toward(PLACES))
    assert ground.emulator.injector.anchors == []
    assert ground.emulator.truth().cable[:, 2].max() < 0.1


def test_a_cable_slides_through_the_jaws() -> None:
    ground = aloft(3, CABLE, gripper="attached")
    ground.emulator.inject(Fault(at=0.0, kind="gripper_slip", vehicle=2, slide=0.2))
    ground.run(0.2, ground.toward(PLACES))
    assert ground.emulator.truth().grip_arc == pytest.approx([0.0, 3.8, 7.2])
    assert ground.emulator.truth().gripped.all()


def test_overlapping_link_faults_end_separately() -> None:
    faults = parse_scenario(
        "{schema: 1, faults: [{at: 1, kind: link, loss: 0.2, duration: 4},"
        " {at: 2, kind: link, latency: 0.5, direction: up, duration: 1}]}"
    )
    emulator = Emulator(world(1), faults)
    down, up = emulator.injector.down[0], emulator.injector.up[0]
    emulator.step(2.5)
    assert (up.fault.latency, down.fault.loss) == (0.5, 0.2)
    emulator.step(3.5)
    assert (up.fault.loss, down.fault.loss) == (0.2, 0.2)
    emulator.step(5.5)
    assert (up.fault, down.fault) == (None, None)
