"""ArduPilot's pre-arm checks and fences."""

import math

from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.ardupilot.tables import MODES
from sitl.protocol import fences

_BASIC_READY = 10.0
ALTITUDE, CIRCLE, POLYGON = 1, 2, 4
"""FENCE_TYPE."""


def refusal(copter: ArduPilotState) -> str | None:
    """Return why arming would fail now, None if it would succeed."""
    v = copter.v
    needs_position = MODES[copter.mode].position and not copter.position_ok()
    checks = (
        (v.now - copter.booted < _BASIC_READY, "Gyros not calibrated"),
        (bool(v.refuse_arming), v.refuse_arming),
        (needs_position, "Need Position Estimate"),
        (bool(v.bodies.crashed[v.index]), "Motors: Check frame"),
        (v.spec.radio and v.radio_lost, "Radio failsafe on"),
        (copter.gcs_lost, "GCS failsafe on"),
        (bool(beyond_fence(copter)), "Vehicle breaching fence"),
        (copter.battery_level > 0, "Battery 1 low voltage failsafe"),
    )
    return next((f"PreArm: {text}" for failed, text in checks if failed), None)


def beyond_fence(copter: ArduPilotState) -> int:
    """Return the fences (bits of FENCE_TYPE) that the vehicle is outside of."""
    v, p = copter.v, copter.v.parameters
    if not p.integer("FENCE_ENABLE") or not copter.position_ok():
        return 0
    here, home = v.estimated(), v.home if v.home is not None else v.origin
    found = 0
    if here[2] - home[2] > p["FENCE_ALT_MAX"]:
        found |= ALTITUDE
    if math.hypot(here[0] - home[0], here[1] - home[1]) > p["FENCE_RADIUS"]:
        found |= CIRCLE
    if fences.breached(v.fence, float(here[0]), float(here[1])):
        found |= POLYGON
    return found & p.integer("FENCE_TYPE")
