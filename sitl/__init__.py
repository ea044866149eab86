"""Emulated vehicles for any MAVLink client, attached to one cable.

    world = load_world("world.yaml")
    emulator = Emulator(world)
    emulator.receive(1, some_bytes, now=0.0)
    for vehicle, data in emulator.step(0.05):
        ...

Written from the autopilots' documented and measured behaviour; it shares no protocol code with the
ground station. `sitl.autopilots` has PX4 and ArduPilot, `sitl.protocol` MAVLink, `sitl.physics` the
motion of vehicles, `sitl.cable` the cable, `sitl.faults` faults, `sitl.server` the sockets.

Conventions: the world is ENU in metres from the world file's origin. A vehicle's centre is
``grip_offset`` above its grip point, on legs of that length: on the ground the grip point touches
the floor. LOCAL_POSITION_NED is the position of the centre relative to the vehicle's own origin: by
default the start of its estimator (its centre on its pad), displaced by up to 30 m.

The emulator answers the requests of QGroundControl's first contact, in its order
(``src/Vehicle/InitialConnectStateMachine.cc``): HEARTBEAT; AUTOPILOT_VERSION on REQUEST_MESSAGE;
AVAILABLE_MODES and COMPONENT_METADATA, which it refuses, and QGroundControl continues without them;
all parameters (over FILE_TRANSFER_PROTOCOL, which it refuses, so that QGroundControl falls back to
PARAM_REQUEST_LIST); mission, fence and rally points. Then ``Vehicle.cc`` shows SYS_STATUS (with the
pre-arm bit), EXTENDED_SYS_STATE, HOME_POSITION, GPS_RAW_INT, GLOBAL_POSITION_INT, ATTITUDE, VFR_HUD
and BATTERY_STATUS. `tests/sitl/test_services.py` tests this sequence.
"""

from sitl.emulator import Emulator, Truth
from sitl.faults import Fault, load_scenario, parse_scenario
from sitl.world import World, WorldError, default_world, load_world, parse_world

__all__ = [
    "Emulator",
    "Fault",
    "Truth",
    "World",
    "WorldError",
    "default_world",
    "load_scenario",
    "load_world",
    "parse_scenario",
    "parse_world",
]
