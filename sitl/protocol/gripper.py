"""A gripper that MAV_CMD_DO_GRIPPER opens and closes."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from sitl.protocol.links import Link


@dataclass(frozen=True)
class GripperRequest:
    """A movement of the gripper: its end time, and the sender that gets the result, if any."""

    at: float
    grab: bool
    link: Link | None = None
    system: int = 0
    component: int = 0


@dataclass
class Gripper:
    """State of one gripper.

    ``installed``: the vehicle has a gripper that obeys MAVLink. ``grab`` and ``release`` attach the
    cable and detach it; each returns whether it did. ``stuck`` is "open", "shut" or None.
    ``closed``: the jaws are closed on nothing, as PX4 closes them when it starts.
    """

    installed: bool
    grab: Callable[[], bool]
    release: Callable[[], bool]
    gripped: bool = False
    closed: bool = False
    stuck: str | None = None
    pending: list[GripperRequest] = field(default_factory=list)

    def start(self, request: GripperRequest) -> None:
        """Start a movement; a repeated request ends when the first one would have ended."""
        ends = [one.at for one in self.pending if one.grab == request.grab]
        self.pending = [replace(request, at=min(ends, default=request.at))]

    def finish(self, now: float) -> list[tuple[GripperRequest, bool]]:
        """Complete the movements that are due; return each with its success."""
        due = [request for request in self.pending if request.at <= now]
        if not due:
            return []
        self.pending = [request for request in self.pending if request.at > now]
        return [(request, self.move(request.grab)) for request in due]

    def move(self, grab: bool) -> bool:
        """Open or close the jaws now; return whether the jaw switch confirms the request."""
        if not self.installed:
            return False
        if grab:
            if self.stuck == "open" or self.gripped:
                return self.gripped
            if self.closed:
                # a servo has no feedback: closed jaws count as a grip
                return True
            self.gripped = self.grab()
            return self.gripped
        if self.stuck == "shut":
            return False
        if self.gripped:
            self.release()
        self.gripped = self.closed = False
        return True
