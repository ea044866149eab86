"""The interface of an autopilot: all that differs between PX4 and ArduPilot."""

from typing import Protocol

from sitl.protocol import wire
from sitl.protocol.links import Command


class Autopilot(Protocol):
    """Modes, commands, setpoints and failsafes of one vehicle."""

    landing: bool
    pilot: bool
    """A pilot controls the vehicle."""
    has_origin: bool
    """The estimator has a global origin."""

    def handle_command(self, command: Command) -> int | None:
        """Execute a command; return its MAV_RESULT, None for an unknown command."""

    def handle_setpoint(self, setpoint: wire.Setpoint) -> None:
        """Accept or ignore a setpoint of position, velocity and acceleration."""

    @property
    def follows_setpoints(self) -> bool:
        """Whether the vehicle follows setpoints of all axes: another one changes only the goal."""
        ...

    def note_setpoint(self, data: bytes, now: float) -> None:
        """Record a setpoint packet whose goal is already set, while `follows_setpoints`."""

    def set_mode(self, base: int, custom: int) -> int:
        """Execute the legacy message SET_MODE; return the MAV_RESULT."""
        ...

    def update(self) -> float:
        """Check timers and conditions; return the time of the next check if no event occurs."""
        ...

    def custom_mode(self) -> int:
        """Return HEARTBEAT.custom_mode."""
        ...

    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode."""
        ...

    def ready_to_arm(self) -> bool:
        """Return the pre-arm bit: arming would succeed."""
        ...

    @property
    def failsafe_active(self) -> bool:
        """Whether HEARTBEAT reports an active failsafe."""
        ...

    @property
    def taking_off(self) -> bool:
        """Whether EXTENDED_SYS_STATE reports a take-off."""
        ...

    @property
    def logging(self) -> bool:
        """Whether the autopilot writes its log."""
        ...

    def parameter_changed(self, name: str) -> None:
        """Apply a parameter that PARAM_SET changed."""

    def restart(self) -> None:
        """Boot."""

    def pilot_override(self) -> None:
        """Select a manual mode, as a pilot's sticks or switch do."""

    def leave_offboard(self) -> None:
        """Leave the mode that follows setpoints."""

    def arm(self, force: bool) -> int:
        """Arm if the checks pass; return the MAV_RESULT."""
        ...

    def disarm(self, reason: str) -> None:
        """Stop the motors immediately."""
