"""Warm-up: compile all inner loops before the first vehicle sends.

On a new machine the first calls take seconds, in which emulated vehicles would send nothing.
"""

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from sitl.emulator import Emulator
from sitl.protocol.vehicle import Vehicle
from sitl.world import parse_world

_STEP = 0.05
_WORLD = """
schema: 1
wind: {steady: [0.5, 0, 0], gust: 0.2}
cable: {points: [[-0.3, 0, 0], [7.5, 0, 0]], attached: [0.3, 3.9, 7.5]}
vehicles:
  - {id: 1, autopilot: px4, pad: [0, 0, 0], gripper: attached}
  - {id: 2, autopilot: ardupilot, pad: [3, 0, 0], gripper: attached}
  - {id: 3, autopilot: px4, pad: [6, 0, 0], gripper: attached}
"""


_SPUN_UP = 10.0
"""Seconds after arming in which the motors of every autopilot have started."""
_FLY = {"px4": 6 << 16, "ardupilot": 4}
_LAND = {"px4": 4 << 16 | 6 << 24, "ardupilot": 9}


def _take_off(vehicle: Vehicle) -> None:
    """Arm a vehicle by force and let it follow setpoints."""
    vehicle.autopilot.set_mode(1, _FLY[vehicle.spec.autopilot])
    vehicle.autopilot.arm(force=True)
    vehicle.bodies.may_lift[vehicle.index] = True
    vehicle.bodies.armed_time[vehicle.index] = _SPUN_UP


def warm_up() -> None:
    """Fly three vehicles with a cable and a loose end in virtual time.

    They climb, fly apart until the cable is taut, release it, and land. The other model of the
    cable makes one step.
    """
    emulator = Emulator(parse_world(_WORLD))
    ground = dialect.MAVLink(None, 255, 190)
    places = np.array([[0.0, 0.0, 3.0], [2.5, 0.0, 3.5], [6.8, 1.0, 3.0]])
    for tick in range(round(14.0 / _STEP)):
        now = tick * _STEP
        packets = []
        for vehicle, place in zip(emulator.vehicles, places, strict=True):
            north, east, down = vehicle.to_local(place)
            setpoint = dialect.MAVLink_set_position_target_local_ned_message(
                0, vehicle.system, 1, 1, 2048, north, east, down, *[0.0] * 6, 0.0, 0.0
            )
            packets.append((vehicle.system, setpoint.pack(ground)))
        if now < 8.0:
            emulator.receive_all(packets, now)
            emulator.receive(*packets[0], now)
        for vehicle in emulator.vehicles:
            if tick == 20:
                _take_off(vehicle)
            elif tick == 160:
                vehicle.environment.release(vehicle.index)
                vehicle.autopilot.set_mode(1, _LAND[vehicle.spec.autopilot])
        emulator.step(now)
    emulator.truth()
    Emulator(parse_world(_WORLD.replace("cable: {", "cable: {model: swinging, "))).step(_STEP)
