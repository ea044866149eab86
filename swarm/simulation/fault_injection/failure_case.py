"""A failure case: the fault, the required detection and the allowed ends."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Part = Literal["fold", "grab", "release"]
"""The part of the flight in which a fault occurs."""

Group = Literal["one vehicle", "links", "ground station", "world"]
StationFault = Literal["stalled", "killed", "interrupted", "interrupted twice"]
End = Literal["continued", "landed", "released and landed", "landed by failsafe", "completed"]
"""How a flight ends after a fault; "continued" is a flight that is still on its plan."""


@dataclass(frozen=True)
class FailureCase:
    """A fault, and the required behaviour of the team.

    - ``faults``: those of the emulator, without time and vehicle; with ``whole_team`` they hit all
      vehicles. ``station_fault`` is a fault of the ground station, ``lost_message`` a message that
      is lost. ``duration`` in seconds, 0 for a permanent fault.
    - ``detection_limit``: seconds within which the fault must be detected, None where no detection
      is required. It is detected by an event, or with ``slows_clock`` by a slower mission clock.
      With ``may_be_hidden`` the time counts only while the fault has a measurable effect, or, but
      for slips, while the vehicle is outside its tracking radius.
    - ``allowed_ends``: with ``pilot_lands`` a pilot lands the vehicle along with the team.
    - ``loses_vehicle``: the fault itself takes a vehicle out of the air. ``moves_certified``: it
      moves vehicles or cable beyond the certificate. ``vehicle_drifts``: it does so with one
      vehicle, and with the cable only where it cannot be released.
    - ``allowed_strikes``: number of rotor strikes on cable that may happen; contacts of one vehicle
      that are more than a second apart are several. With ``own_strikes`` those of the failed
      vehicle, which drifts, are not counted. With ``cannot_follow`` the vehicle
      stays where it is and the others with it; one more strike may happen where the team can
      neither land nor release without cable on a rotor. With ``lands_alone`` the failsafes
      of the autopilots land the vehicles where they are; one more strike may happen where the
      plan has no window for landing. During the first ``fall_time`` seconds any number may: the
      cable falls because of the fault.
    - ``stream_loss``: vehicles fly on without setpoints, so the worst case of the stream loss
      certificate applies: the mission's own clearances.
    - ``needs_cable``: without cable there is no such fault, or none that has to slow the team.
      ``least_vehicles``: so many are compared to detect it.
    - ``explanation``: the reason for exceptions.
    """

    name: str
    group: Group
    allowed_ends: tuple[End, ...]
    faults: tuple[Mapping[str, Any], ...] = ()
    part: Part = "fold"
    detection_limit: float | None = None
    slows_clock: bool = False
    may_be_hidden: bool = False
    whole_team: bool = False
    loses_vehicle: bool = False
    moves_certified: bool = False
    vehicle_drifts: bool = False
    allowed_strikes: int = 0
    own_strikes: bool = False
    cannot_follow: bool = False
    lands_alone: bool = False
    fall_time: float = 0.0
    stream_loss: bool = False
    explanation: str = ""
    station_fault: StationFault | None = None
    duration: float = 0.0
    lost_message: str = ""
    pilot_lands: bool = False
    needs_cable: bool = False
    least_vehicles: int = 1
