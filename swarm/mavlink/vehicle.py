"""One vehicle as the ground station uses it, sans-IO: packets in, events and messages out.

:mod:`swarm.mavlink.vehicle_state` holds the state, :mod:`swarm.mavlink.message_handlers` changes
it, :mod:`swarm.mavlink.autopilots` lists the differences between autopilots, and
:mod:`swarm.mavlink.commands` tracks every command until it is done.
"""

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common

from swarm.errors import VehicleError
from swarm.mavlink.autopilots import Mode, flying_autopilot
from swarm.mavlink.commands import STATE_TIMEOUT, Command
from swarm.mavlink.message_handlers import HANDLERS, end_texts, read_text
from swarm.mavlink.packets import Message, Packet, message_name
from swarm.mavlink.telemetry_table import DOUBTED, STAMPED, count_packet, follows
from swarm.mavlink.vehicle_state import VehicleState

_CUSTOM = int(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_KILL = 21196.0
_HEARTBEAT, _TEXT = int(common.MAVLINK_MSG_ID_HEARTBEAT), int(common.MAVLINK_MSG_ID_STATUSTEXT)
TAKEOFF_TIMEOUT = 15.0
"""Seconds from the acknowledgement of a take-off until it flies: motors spool up first."""
_ECHOES = frozenset({int(common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED)})
"""Messages with the autopilot's own setpoints: sent once it is armed, as often as positions."""


class Vehicle(VehicleState):
    """A vehicle's state, with methods that read its packets and queue commands to it."""

    def __copy__(self) -> "Vehicle":
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin.telemetry, twin.row = self.telemetry.copy_row(self.row), 0
        return twin

    def receive(self, packet: Packet, now: float, link: int = 0) -> None:
        """Count and read a packet with this vehicle's system id, from a link by its number."""
        number, _, component, sequence, message = packet
        order = DOUBTED
        if component == self.component:
            fresh = False
            if number in STAMPED and message is not None:
                last = float(self.values[STAMPED[number]])
                fresh = follows(float(message.time_boot_ms), last)
            order = count_packet(self.telemetry.arrays, self.row, link, sequence, now, fresh)
        self.read(number, component, message, now, order)

    def read(
        self, number: int, component: int, message: Message | None, now: float, order: int
    ) -> None:
        """Read the message of a packet that has been counted.

        Of other components than the autopilot's, only texts are read.
        """
        if number == _HEARTBEAT and message is not None and component != self.component:
            self._choose(component, message)
        if self.text_chunks:
            end_texts(self, now)
        if component != self.component:
            if number == _TEXT and message is not None:
                read_text(self, message, now, component)
            return
        handler = HANDLERS.get(number)
        if handler is None or message is None:
            self.unhandled[number] = self.unhandled.get(number, 0) + 1
        else:
            self.order = order
            handler(self, message, now)

    def _choose(self, component: int, heartbeat: Message) -> None:
        """Take the component of a heartbeat for the vehicle, if it is its autopilot's.

        The first one stays, except for MAVLink's own id of autopilots while nothing is armed.
        """
        first = self.heartbeat_at == -math.inf
        preferred = component == common.MAV_COMP_ID_AUTOPILOT1 and not self.armed
        if (first or preferred) and flying_autopilot(component, heartbeat) is not None:
            self.component = self.commands.component = component

    def note_clock_request(self, now: float) -> None:
        """Note that a clock request was sent, which a vehicle that has answered any answers."""
        if math.isinf(self.asked_at) and math.isfinite(self.timesync_at):
            self.asked_at = now

    @property
    def busy(self) -> bool:
        """Whether there may be messages to send."""
        return self.commands.busy or self.parameters.busy or self.fence.busy

    def tick(self, now: float) -> list[Message]:
        """Return the messages to send now."""
        if not self.busy:
            return []
        messages, results = self.commands.tick(now)
        if self.parameters.busy and self.autopilot is not None:
            messages += self.parameters.tick(
                self.system, self.component, bytewise=self.autopilot.bytewise, now=now
            )
        if self.fence.busy:
            messages += self.fence.tick(self.system, self.component, now)
        for result in results:
            name = result.command.name
            if result.succeeded:
                self.report("done", f"{name}: done after {result.after:.2f} s", name)
            else:
                warnings = self.recent_warnings(now)
                text = f"{name}: {result.reason}" + (f" ({warnings})" if warnings else "")
                self.report("failed", text, name)
        return messages

    def set_mode(self, mode: Mode) -> None:
        """Command a mode; done when HEARTBEAT shows it."""
        if self.autopilot is None:
            raise VehicleError(f"system {self.system}: unknown autopilot, so no mode can be set")
        main, sub = self.autopilot.modes[mode]
        self._command(
            f"mode {mode}",
            common.MAV_CMD_DO_SET_MODE,
            _CUSTOM,
            main,
            sub,
            reached=lambda: self.in_mode(mode),
            retry_for=5.0,
        )

    def set_custom_mode(self, custom_mode: int) -> None:
        """Command a mode by its value in HEARTBEAT; done when HEARTBEAT shows it."""
        packed = self.autopilot is None or self.autopilot.name == "px4"
        main, sub = (custom_mode >> 16 & 0xFF, custom_mode >> 24) if packed else (custom_mode, 0)
        self._command(
            "mode before",
            common.MAV_CMD_DO_SET_MODE,
            _CUSTOM,
            main,
            sub,
            reached=lambda: self.custom_mode == custom_mode,
        )

    def arm(self) -> None:
        """Command arming, never by force; done when HEARTBEAT shows it."""
        self._command(
            "arm",
            common.MAV_CMD_COMPONENT_ARM_DISARM,
            1,
            reached=lambda: self.armed,
            retry_for=5.0,
        )

    def disarm(self) -> None:
        """Command disarming, which an autopilot accepts only on the ground."""
        self._command(
            "disarm", common.MAV_CMD_COMPONENT_ARM_DISARM, 0, reached=lambda: not self.armed
        )

    def kill(self) -> None:
        """Stop the motors at once, also in the air."""
        self.commands.clear()
        self._command(
            "kill", common.MAV_CMD_COMPONENT_ARM_DISARM, 0, _KILL, reached=lambda: not self.armed
        )

    def take_off(self, height: float) -> None:
        """Command a take-off to a height in metres above the present position.

        Done when the vehicle reports that it flies, if it sends EXTENDED_SYS_STATE: a command that
        is repeated after a lost acknowledgement is rejected in the air.
        """
        self._command(
            "takeoff",
            common.MAV_CMD_NAV_TAKEOFF,
            *(0, 0, 0, 0, 0, 0, height),
            reached=(lambda: self.airborne) if self.landed_state else None,
            state_timeout=TAKEOFF_TIMEOUT,
        )

    def grip(self, *, closed: bool) -> None:
        """Close or open the gripper."""
        action = common.GRIPPER_ACTION_GRAB if closed else common.GRIPPER_ACTION_RELEASE
        self._command("grab" if closed else "release", common.MAV_CMD_DO_GRIPPER, 1, action)

    def request_interval(self, message: int, rate: float) -> None:
        """Request a message at a rate in Hz."""
        self._set_interval(message, 1e6 / rate)

    def stop_unused_streams(self, since: float, now: float) -> None:
        """Stop messages that arrive more than three times a second and have no handler.

        ``since`` is the time of the first packet. The link is then free for what the flight needs.
        Messages that are sent only while armed are stopped in advance.
        """
        often = {message for message, n in self.unhandled.items() if n > 3.0 * (now - since)}
        for message in sorted((often | _ECHOES) - self._stopped_streams):
            self._stopped_streams.add(message)
            self._set_interval(message, -1.0)

    def restore_streams(self) -> None:
        """Restart what :meth:`stop_unused_streams` stopped, at the autopilot's default rates."""
        for message in self._stopped_streams:
            self._set_interval(message, 0.0)
        self._stopped_streams.clear()

    def _set_interval(self, message: int, microseconds: float) -> None:
        name = message_name(message)
        command = common.MAV_CMD_SET_MESSAGE_INTERVAL
        self._command(f"interval of {name}", command, message, microseconds)

    def request_message(self, message: int, reached: Callable[[], bool] | None = None) -> None:
        """Request a message once."""
        name = message_name(message)
        self._command(name, common.MAV_CMD_REQUEST_MESSAGE, message, reached=reached)

    def _command(
        self,
        name: str,
        number: int,
        *parameters: float,
        reached: Callable[[], bool] | None = None,
        state_timeout: float = STATE_TIMEOUT,
        retry_for: float = 0.0,
    ) -> None:
        if self.commands.contains(name):
            return
        seven = (*parameters, *[0.0] * (7 - len(parameters)))
        self.commands.add(Command(name, int(number), seven, reached, state_timeout, retry_for))
