"""The flight at one moment, for displays and records; and what is kept of it while it is flown."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swarm.certification.findings import Finding
from swarm.certification.monitor import Clearances
from swarm.flight.trace import Trace

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """The team at one moment, by its reports.

    ``time`` is seconds since the flight's record began, ``mission_time`` and ``rate`` the mission
    clock. ``position``, ``velocity`` and ``setpoint`` (n, 3) are of grip points in mission ENU,
    NaN where unknown; ``battery`` (n,) is a share 0…1, ``link_age`` (n,) seconds since a vehicle
    was last received. ``modes`` and ``states`` are words per vehicle. ``clearances`` come from the
    live monitor (None while the cable is on the floor); ``available`` has, for each operator
    command, whether it is possible now, and its effect. ``round_trip`` (n,) is the latest in
    seconds, ``received`` and ``lost`` (n,) count packets since the record began; empty where they
    are not counted.

    ``waiting_for`` is what the clock waits for, ``held`` why the team holds, ``time_left`` the
    seconds until the gate's or the hold's timeout, ``remaining`` the seconds to the end of the plan
    without waiting; None where they do not apply. ``stray`` (n − 1,) is how far each strand is
    estimated from its catenary, in metres, and ``cable`` (n − 1, k, 3) are points of the strands;
    None while no cable is aloft.

    ``problems`` says of each vehicle why it is not ready, or does not follow the plan, "" where
    nothing is wrong; ``missing`` are the numbers (from 1) of the vehicles that the clock waits for.
    ``voltage`` (n,) is in volts, ``fix`` (n,) GPS_FIX_TYPE and ``satellites`` (n,) what the
    receivers report (-1: nothing), ``position_age`` (n,) seconds since a vehicle's last position;
    empty where they are not reported. ``landing`` is the expected time until all have landed as
    planned, in seconds, with waits at gates and a slower clock; None where it is not known.
    ``numbers`` are those by which displays name the vehicles; empty: 1, 2, …, along the cable.
    ``windows`` says in how many seconds of mission time all can "land" together, or "release" the
    cable: 0 now, None not any more. ``slowed_by`` names what the clock is slower for; "": nothing.
    """

    time: float
    mission_time: float
    rate: float
    phase: str
    waiting_for: str | None
    position: Floats
    velocity: Floats
    setpoint: Floats
    modes: tuple[str, ...]
    states: tuple[str, ...]
    armed: tuple[bool, ...]
    gripped: tuple[bool, ...]
    battery: Floats
    link_age: Floats
    clearances: Clearances | None = None
    available: Mapping[str, tuple[bool, str]] = field(default_factory=dict)
    round_trip: Floats = field(default_factory=lambda: np.zeros(0))
    received: Floats = field(default_factory=lambda: np.zeros(0))
    lost: Floats = field(default_factory=lambda: np.zeros(0))
    held: str | None = None
    time_left: float | None = None
    remaining: float | None = None
    stray: Floats | None = None
    cable: Floats | None = None
    problems: tuple[str, ...] = ()
    missing: tuple[int, ...] = ()
    voltage: Floats = field(default_factory=lambda: np.zeros(0))
    fix: Floats = field(default_factory=lambda: np.zeros(0))
    satellites: Floats = field(default_factory=lambda: np.zeros(0))
    position_age: Floats = field(default_factory=lambda: np.zeros(0))
    landing: float | None = None
    windows: Mapping[str, float | None] = field(default_factory=dict)
    slowed_by: str = ""
    numbers: tuple[int, ...] = ()


@dataclass(frozen=True)
class Event:
    """An event: seconds since the record began, kind, message, and the vehicle (from 1)."""

    time: float
    kind: str
    message: str
    vehicle: int | None = None


@dataclass(frozen=True)
class Checked:
    """What the check of a team on the ground has found so far.

    ``steps`` are the names of its parts, in their order, where it is no part of a flight.
    """

    findings: tuple[Finding, ...]
    steps: tuple[str, ...] = ()


class Recorder:
    """Events since they were last taken, and all samples of the flight, which do not change."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self.samples: list[tuple[float, float, Floats, Floats, str, Floats]] = []
        self.next_sample = 0.0

    def event(self, time: float, kind: str, message: str, vehicle: int | None) -> None:
        """Add an event; ``vehicle`` is counted from 1."""
        self._events.append(Event(time, kind, message, vehicle))

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def sample(
        self,
        times: tuple[float, float],
        places: tuple[Floats, Floats],
        phase: str,
        stray: Floats,
    ) -> None:
        """Add a moment: its time and mission time, positions and setpoints (n, 3), the plan's
        phase, and the strays (n − 1,) of the strands."""
        self.samples.append((*times, *places, phase, stray))

    def trace(self, n: int, segments: int) -> Trace:
        """Return the flight of n vehicles with so many cable segments so far."""
        samples = self.samples
        return Trace(
            time=np.array([row[0] for row in samples]),
            mission_time=np.array([row[1] for row in samples]),
            position=np.array([row[2] for row in samples]).reshape(-1, n, 3),
            setpoint=np.array([row[3] for row in samples]).reshape(-1, n, 3),
            phase=tuple(row[4] for row in samples),
            stray=np.array([row[5] for row in samples]).reshape(len(samples), segments),
        )
