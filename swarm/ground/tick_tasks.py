"""The work of the flight process after every tick: requests, events, snapshots, the go."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from swarm.errors import Refused
from swarm.flight.clearance import Audit, go
from swarm.flight.conductor import Conductor
from swarm.flight.snapshot import Event, Snapshot
from swarm.flight.tlog import ClockEncoder
from swarm.ground.emulator import EmulatorProcess
from swarm.ground.mocap import UNSEEN, MocapBridge
from swarm.ground.preflight import Preflight
from swarm.ground.record import Record

SNAPSHOT_INTERVAL = 0.1


@dataclass
class TickTasks:
    """Passes requests to the conductor, and its events and snapshots to record and callbacks.

    ``inputs`` are polled for operator requests. ``interrupts`` are signals that have been caught
    and are to be handled. ``events`` are all events so far.
    Poses that ``mocap`` misses are reported.
    """

    conductor: Conductor
    record: Record
    preflight: Preflight
    publish: Callable[[Snapshot | Event], None]
    interrupts: list[int]
    emulator: EmulatorProcess | None = None
    inputs: Sequence[Callable[[], None]] = ()
    events: list[Event] = field(default_factory=list)
    mocap: MocapBridge | None = None
    _next_snapshot: float = 0.0
    _disk_reported: bool = False
    _phase: str = ""
    _unseen: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        self._clock = ClockEncoder(self.conductor.plan)

    def run(self, now: float) -> None:
        """Do the work after the tick at ``now``."""
        conductor = self.conductor
        while self.interrupts:
            self.interrupts.pop()
            conductor.request("interrupt")
        for poll in self.inputs:
            poll()
        if conductor.stage == "ready" and conductor.audit is not None:
            self._decide(conductor.audit)
        for event in conductor.events():
            self.events.append(event)
            self.record.event(event)
            self.publish(event)
        if now >= self._next_snapshot:
            self._next_snapshot = now + SNAPSHOT_INTERVAL
            self._snapshot(now)

    def _snapshot(self, now: float) -> None:
        conductor, record = self.conductor, self.record
        self.publish(conductor.snapshot(now))
        if record.problem is not None and not self._disk_reported:
            self._disk_reported = True
            text = f"the record cannot be written: {record.problem}; the flight goes on"
            conductor.report("record", text)
        phase = conductor.phase.name if conductor.stage == "execute" else ""
        if (entered := phase or conductor.stage) != self._phase:
            self._phase = entered
            conductor.report("phase", entered)
        self._report_poses(now)
        if conductor.stage in {"ready", "execute", "contingency"}:
            record.packet(self._clock.encode(now, conductor.clock.time, phase), now)
        if conductor.stage == "prepare" and self.emulator is not None:
            ended = self.emulator.ended()
            if ended is not None:
                conductor.give_up(ended)

    def _report_poses(self, now: float) -> None:
        """Report vehicles whose poses are missing, and when all have poses again."""
        unseen = self.mocap.unseen(now) if self.mocap is not None else ()
        if unseen == self._unseen:
            return
        self._unseen = unseen
        names = ", ".join(map(str, unseen))
        text = f"no pose of system {names} for {UNSEEN:g} s" if unseen else "has all poses again"
        self.conductor.report("motion capture", text)

    def _decide(self, audit: Audit) -> None:
        """Start the preflight once; start or refuse the flight when it has decided."""
        preflight, conductor = self.preflight, self.conductor
        if not preflight.started:
            preflight.start(audit)
        decision = preflight.decision()
        if decision is None:
            return
        if preflight.relay is not None:
            preflight.relay.closed = True
        if isinstance(decision, str):
            conductor.refuse(decision)
            return
        try:
            conductor.start(go(conductor.flight_plan, decision))
        except Refused as error:
            conductor.refuse(str(error))
