"""A small ground station for tests: pymavlink against the emulator in virtual time."""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator, parse_world

STEP = 0.05
_QUIET: dict[str, float | None] = {
    "LOCAL_POSITION_NED": 0.1,
    "ATTITUDE": 0.2,
    "ESTIMATOR_STATUS": None,
    "GPS_RAW_INT": None,
    "GPS_GLOBAL_ORIGIN": 1.0,
    "SYSTEM_TIME": None,
    "EXTENDED_SYS_STATE": 0.5,
    "SYS_STATUS": 0.5,
    "ALTITUDE": None,
    "ATTITUDE_QUATERNION": None,
    "ODOMETRY": None,
    "GLOBAL_POSITION_INT": 0.5,
    "NAV_CONTROLLER_OUTPUT": None,
    "POSITION_TARGET_LOCAL_NED": None,
    "RC_CHANNELS": None,
    "SERVO_OUTPUT_RAW": None,
    "VFR_HUD": None,
}
"""Intervals for tests: PX4's default rates are hundreds of messages a second."""
Setpoints = Callable[[int, float], tuple[float, ...] | None]


def world(count: int = 1, cable: str = "", **keys: Any) -> Any:
    """Return a world of ``count`` vehicles 3 m apart along x; ``keys`` are of all vehicles."""
    autopilots = keys.pop("autopilots", [keys.pop("autopilot", "px4")])
    common = keys
    top = {
        key: common.pop(key)
        for key in ("biases", "seed", "indoor", "wind", "projection")
        if key in common
    }
    extra = ", ".join(f"{key}: {value}" for key, value in common.items())
    settings = {"schema": 1, "biases": "none", "projection": "exact", **top}
    lines = [f"{key}: {value}" for key, value in settings.items()]
    lines.append("vehicles:")
    for i in range(count):
        autopilot = autopilots[i % len(autopilots)]
        lines.append(
            f"  - {{id: {i + 1}, autopilot: {autopilot}, pad: [{3.0 * i}, 0, 0], {extra}}}"
        )
    if cable:
        lines.append(f"cable: {cable}")
    return parse_world("\n".join(lines))


class Ground:
    """Sends and receives MAVLink bytes; time advances only in `run`."""

    def __init__(self, emulator: Emulator, *, quiet: bool = True) -> None:
        self.emulator = emulator
        self.now = 0.0
        self.ids = [vehicle.id for vehicle in emulator.world.vehicles]
        self.mav = {i: dialect.MAVLink(None, 255, 190) for i in self.ids}
        for mav in self.mav.values():
            mav.robust_parsing = True
        if quiet:
            for vehicle in emulator.vehicles:
                for name in set(vehicle.links[0].intervals) & set(_QUIET):
                    vehicle.links[0].stream(name, _QUIET[name], 0.0)
        self.log: list[tuple[float, int, Any]] = []
        self.last: dict[tuple[int, str], Any] = {}

    def send(self, vehicle: int, message: Any) -> None:
        self.emulator.receive(vehicle, message.pack(self.mav[vehicle]), self.now)

    def command(self, vehicle: int, number: int, *p: float) -> None:
        values = [*p, *[0.0] * (7 - len(p))]
        self.send(vehicle, dialect.MAVLink_command_long_message(vehicle, 1, number, 0, *values))

    def setpoint(self, vehicle: int, values: tuple[float, ...], mask: int = 3072) -> None:
        """Send position, velocity, acceleration in the vehicle's NED (missing ones are zero)."""
        full = (*values, *[0.0] * (9 - len(values)))
        self.send(
            vehicle,
            dialect.MAVLink_set_position_target_local_ned_message(
                0, vehicle, 1, 1, mask, *full, 0.0, 0.0
            ),
        )

    def run(
        self, seconds: float, setpoints: Setpoints | None = None, heartbeat: bool = True
    ) -> None:
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now = round(self.now + STEP, 6)
            for vehicle in self.ids:
                wanted = setpoints(vehicle, self.now) if setpoints else None
                if wanted is not None:
                    self.setpoint(vehicle, wanted)
                if heartbeat and round(self.now / STEP) % 20 == 0:
                    self.send(vehicle, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            for vehicle, data in self.emulator.step(self.now):
                for message in self.mav[vehicle].parse_buffer(data) or []:
                    self.log.append((self.now, vehicle, message))
                    self.last[vehicle, message.get_type()] = message

    def mode(self, vehicle: int) -> int:
        return int(self.last[vehicle, "HEARTBEAT"].custom_mode)

    def armed(self, vehicle: int) -> bool:
        return bool(self.last[vehicle, "HEARTBEAT"].base_mode & 128)

    def acks(self, vehicle: int, command: int) -> list[int]:
        return [
            message.result
            for _, system, message in self.log
            if system == vehicle
            and message.get_type() == "COMMAND_ACK"
            and message.command == command
        ]

    def texts(self, vehicle: int) -> list[str]:
        """Return the texts of a vehicle, with joined chunks."""
        texts: list[str] = []
        for _, system, message in self.log:
            if system == vehicle and message.get_type() == "STATUSTEXT":
                if message.id and message.chunk_seq:
                    texts[-1] += message.text
                else:
                    texts.append(message.text)
        return texts

    def origin(self, vehicle: int) -> Any:
        """Return the origin of the vehicle's estimator in world ENU."""
        return self.emulator.by_id[vehicle].origin

    def toward(self, places: dict[int, tuple[float, float, float]]) -> Setpoints:
        """Return setpoints that hold the vehicles' centres at positions in world ENU."""

        def goal(vehicle: int, _: float) -> tuple[float, ...] | None:
            if vehicle not in places:
                return None
            x, y, z = (
                float(a - b) for a, b in zip(places[vehicle], self.origin(vehicle), strict=True)
            )
            return (y, x, -z)

        return goal

    def px4_offboard(self, places: dict[int, tuple[float, float, float]], seconds: float) -> None:
        """Start the stream, set the mode, arm and fly to the positions, in PX4's order."""
        stream = self.toward(places)
        self.run(1.0, stream)
        for vehicle in places:
            self.command(vehicle, dialect.MAV_CMD_DO_SET_MODE, 1, 6, 0)
        self.run(0.3, stream)
        for vehicle in places:
            self.command(vehicle, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.run(seconds, stream)
