"""The fence of one vehicle through the mission protocol: upload, read back, clear. Sans-IO.

The vehicle asks for the items of an upload one after the other; reading is the reverse. What has no
answer is sent again. What was uploaded is always read back, so that ``items`` is what the vehicle
has, also where its acknowledgement was lost.

| state | we have sent | the vehicle answers | then |
| --- | --- | --- | --- |
| uploading | MISSION_COUNT | MISSION_REQUEST(_INT): MISSION_ITEM_INT; MISSION_ACK | listing |
| clearing | MISSION_CLEAR_ALL | MISSION_ACK | listing |
| listing | MISSION_REQUEST_LIST | MISSION_COUNT | reading; idle if 0 |
| reading | MISSION_REQUEST_INT | MISSION_ITEM_INT, until all are there | idle |
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from pymavlink.dialects.v20 import common

from swarm.mavlink.packets import GROUND_SYSTEM, Message, enum_words

_FENCE = int(common.MAV_MISSION_TYPE_FENCE)
_AGAIN = 1.5
"""Seconds without an answer after which a message is sent again (mission protocol, mavlink.io)."""
_ATTEMPTS = 10
"""As for commands: at 20 % of loss each way, 99.9 % of 20 items have all arrived."""
_RESENT = 4
"""Times a message of an upload is sent before it starts anew: autopilots forget it after 5 s."""
_MOST_ITEMS = 500
"""Items of a list that are read: more than any autopilot stores of a fence."""

_RESULTS = enum_words("MAV_MISSION_RESULT", "MAV_MISSION_")

State = Literal["idle", "uploading", "clearing", "listing", "reading"]


class FenceItem(NamedTuple):
    """An item of a fence: MAV_CMD_NAV_FENCE_*, MAV_FRAME, its parameters, 1e-7 degrees, metres."""

    command: int
    frame: int
    parameters: tuple[float, float, float, float]
    x: int
    y: int
    z: float

    def message(self, target: tuple[int, int], sequence: int) -> Message:
        """Return the item as MISSION_ITEM_INT."""
        return common.MAVLink_mission_item_int_message(
            *target, sequence, self.frame, self.command, 0, 1, *self.parameters, self.x, self.y,
            self.z, _FENCE,
        )  # fmt: skip

    def same_place(self, other: "FenceItem") -> bool:
        """Return whether an item has the same meaning; autopilots fill the other fields anew."""
        key = self.command, self.parameters[0], self.x, self.y
        return key == (other.command, other.parameters[0], other.x, other.y)


def polygon(corners: Sequence[tuple[float, float]]) -> tuple[FenceItem, ...]:
    """Return the fence that keeps a vehicle inside a polygon of (latitude, longitude), degrees."""
    return tuple(
        FenceItem(
            int(common.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
            int(common.MAV_FRAME_GLOBAL),
            (float(len(corners)), 0.0, 0.0, 0.0),
            round(latitude * 1e7),
            round(longitude * 1e7),
            0.0,
        )
        for latitude, longitude in corners
    )


def same_fence(items: Sequence[FenceItem], others: Sequence[FenceItem]) -> bool:
    """Return whether two fences mean the same."""
    return len(items) == len(others) and all(map(FenceItem.same_place, items, others))


@dataclass
class Fence:
    """The fence of one vehicle; ``items`` are None until they are read.

    :meth:`fetch` and :meth:`upload` only store a request, and may be called from another thread;
    all protocol work is done in :meth:`tick` and where messages are processed. ``problem`` is the
    reason why the last request failed, empty otherwise.
    """

    items: tuple[FenceItem, ...] | None = None
    problem: str = ""
    _state: State = "idle"
    _given: tuple[FenceItem, ...] = ()
    _read: list[FenceItem] = field(default_factory=list)
    _total: int = 0
    _asked: list[int] = field(default_factory=list)
    _sent: int = -1
    _starts: int = 0
    _doubtful: bool = False
    _attempts: int = 0
    _next: float = -math.inf

    @property
    def busy(self) -> bool:
        """Whether the fence is being read or uploaded."""
        return self._state != "idle"

    def fetch(self) -> None:
        """Read the fence; done when no longer :attr:`busy`."""
        self.problem, self.items, self._doubtful = "", None, False
        self._enter("listing")

    def upload(self, items: Sequence[FenceItem]) -> None:
        """Replace the fence, none: clear it, and read it back; done when no longer :attr:`busy`."""
        self.problem, self.items, self._given = "", None, tuple(items)
        self._starts, self._doubtful = 0, False
        self._enter("uploading" if items else "clearing")

    def _enter(self, state: State) -> None:
        self._asked.clear()
        self._sent = -1
        self._state, self._attempts, self._next = state, 0, -math.inf

    def _fail(self, words: str) -> None:
        self.problem = words
        self._enter("idle")

    def _awaits(self, message: Message, *states: State) -> bool:
        """Return whether a message is for us, of a fence, and expected now."""
        ours = message.target_system == GROUND_SYSTEM and message.mission_type == _FENCE
        return ours and self._state in states

    def requested(self, message: Message) -> None:
        """Process a MISSION_REQUEST or MISSION_REQUEST_INT."""
        if self._awaits(message, "uploading") and message.seq < len(self._given):
            self._asked.append(message.seq)

    def acknowledged(self, message: Message) -> None:
        """Process a MISSION_ACK."""
        if not self._awaits(message, "uploading", "clearing"):
            return
        if message.type == common.MAV_MISSION_ACCEPTED:
            self._enter("listing")
        elif self._attempts > 1 and self._state == "uploading":
            self._start_again()  # it had given the upload up, or its first answer was lost
        elif message.type != common.MAV_MISSION_INVALID_SEQUENCE:
            self._fail(f"refused the fence: {_RESULTS.get(message.type, message.type)}")

    def counted(self, message: Message) -> None:
        """Process a MISSION_COUNT."""
        if not self._awaits(message, "listing"):
            return
        if message.count > _MOST_ITEMS:
            self._fail(f"reports a fence of {message.count} items")
            return
        self._read, self._total = [], message.count
        self._enter("reading")

    def item(self, message: Message) -> None:
        """Process a MISSION_ITEM_INT."""
        m = message
        if self._awaits(m, "reading") and m.seq == len(self._read):
            parameters = (m.param1, m.param2, m.param3, m.param4)
            self._read.append(FenceItem(m.command, m.frame, parameters, m.x, m.y, m.z))
            self._attempts, self._next = 0, -math.inf

    def _start_again(self) -> None:
        """Send the list again; after its last item, first read whether it was stored."""
        if self._sent == len(self._given) - 1:
            self._doubtful = True
            self._enter("listing")
        elif self._starts >= _ATTEMPTS:
            self._fail("does not take its fence")
        else:
            self._starts += 1
            self._enter("uploading")

    def tick(self, system: int, component: int, now: float) -> list[Message]:
        """Return the messages to send to the vehicle now."""
        target, accepted = (system, component), common.MAV_MISSION_ACCEPTED
        if self._state == "reading" and len(self._read) == self._total:
            if self._doubtful and not same_fence(self._read, self._given):
                self._doubtful = False
                self._start_again()
            else:
                self.items = tuple(self._read)
                self._enter("idle")
            return [common.MAVLink_mission_ack_message(*target, accepted, _FENCE)]
        if self._asked:
            asked, self._attempts = dict.fromkeys(self._asked), 0
            self._asked.clear()
            return [self._item(target, k, now) for k in asked]
        if self._state == "uploading" and now >= self._next and self._attempts >= _RESENT:
            self._start_again()
        elif now >= self._next and self._attempts >= _ATTEMPTS:
            self._fail("does not answer about its fence")
        if self._state == "idle" or now < self._next:
            return []
        if self._sent >= 0:
            return [self._item(target, self._sent, now)]
        self._attempts, self._next = self._attempts + 1, now + _AGAIN
        return [self._request(target)]

    def _item(self, target: tuple[int, int], number: int, now: float) -> Message:
        self._attempts, self._next, self._sent = self._attempts + 1, now + _AGAIN, number
        return self._given[number].message(target, number)

    def _request(self, target: tuple[int, int]) -> Any:
        if self._state == "uploading":
            return common.MAVLink_mission_count_message(*target, len(self._given), _FENCE)
        if self._state == "clearing":
            return common.MAVLink_mission_clear_all_message(*target, _FENCE)
        if self._state == "listing":
            return common.MAVLink_mission_request_list_message(*target, _FENCE)
        return common.MAVLink_mission_request_int_message(*target, len(self._read), _FENCE)
