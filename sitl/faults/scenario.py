"""What goes wrong, when: faults of vehicles and links, from a scenario file or from MAVLink.

    schema: 1
    faults:
      - {at: 12.0, kind: weak_thrust, vehicle: 3, fraction: 0.7, duration: 5.0}
      - {at: 20.0, kind: link, vehicle: all, loss: 0.2, latency: 0.3, jitter: 0.1}

Times are emulated seconds since the start. A fault without ``duration`` stays. The same faults are
reached by ``MAV_CMD_INJECT_FAILURE`` (so that other people's test tools drive them) and by
``SIM_*`` parameters: see `sitl.faults.mapping`.

A frozen autopilot neither hears nor speaks nor looks at its timers; its controller goes on with the
last goal. A rebooting one stops its motors. ``rc_loss`` matters where the world file gives a
vehicle a ``radio``. ``snag`` holds the cable where it is by friction on other cable: it falls when
nobody holds any.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sitl.world import WorldError, explain, parse_yaml, read_text

Vector = tuple[float, float, float]
_BLOCK = 256
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_NotNegative = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]
_Seconds = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]

# What each kind of fault may be told, beside at, kind, vehicle and duration.
KINDS: dict[str, tuple[str, ...]] = {
    "link": (
        "loss",
        "burst",
        "latency",
        "jitter",
        "duplicate",
        "reorder",
        "bandwidth",
        "direction",
    ),
    "motor_loss": (),
    "weak_thrust": ("fraction",),
    "battery": ("charge",),
    "gps_loss": (),
    "gps_jump": ("offset",),
    "position_loss": (),
    "origin_reset": ("offset",),
    "barometer_drift": ("rate",),
    "freeze": (),
    "reboot": (),
    "refuse_arming": ("text",),
    "pilot": (),
    "rc_loss": (),
    "leave_offboard": (),
    "disarm": (),
    "believes_landed": (),
    "gripper_stuck_open": (),
    "gripper_stuck_shut": (),
    "gripper_slip": ("slide",),
    "slow_clock": ("fraction",),
    "wind": ("steady", "gust"),
    "snag": ("arc", "friction"),
}
WORLDWIDE = frozenset({"wind", "snag"})


class Fault(BaseModel):
    """One fault: when, what, in which vehicles, for how long, and how bad."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at: _Seconds = Field(description="when it begins, emulated seconds since the start")
    kind: Literal[tuple(KINDS)] = Field(  # type: ignore[valid-type]
        description="what goes wrong; it decides which of the other keys may be given"
    )
    vehicle: int | list[int] | Literal["all"] = Field(
        default="all", description="system ids of the vehicles; of no effect for wind and snag"
    )
    duration: _Seconds | None = Field(default=None, description="s; none: it stays")
    loss: _Share = Field(default=0.0, description="share of packets that are lost")
    burst: _Seconds = Field(default=0.0, description="mean length of a run of losses, s")
    latency: _Seconds = Field(default=0.0, description="delay of every packet, s")
    jitter: _Seconds = Field(
        default=0.0, description="delay on top, s: uniform from 0 to this for each packet"
    )
    duplicate: _Share = Field(default=0.0, description="share of packets that arrive twice")
    reorder: _Share = Field(
        default=0.0, description="share of packets that later ones may overtake"
    )
    bandwidth: float | None = Field(default=None, gt=0, description="bytes per second")
    direction: Literal["up", "down", "both"] = Field(
        default="both", description="up: to the vehicle, down: from it"
    )
    fraction: Annotated[float, Field(ge=0.0, le=2.0)] = Field(
        default=0.7, description="share of the thrust, or of the clock's rate, that is left"
    )
    charge: _Share = Field(default=0.1, description="share of the battery's charge that is left")
    offset: Vector = Field(
        default=(5.0, 0.0, 0.0), description="metres by which the position or origin jumps, ENU"
    )
    rate: Annotated[float, Field(ge=-5, le=5)] = Field(
        default=0.1, description="m/s at which the barometer's height drifts"
    )
    text: Annotated[str, Field(max_length=100)] = Field(
        default="Resolve system health failures first", description="reason given for refusing"
    )
    steady: Vector | None = Field(
        default=None, description="steady wind, m/s, ENU, where it blows to; none: as it was"
    )
    gust: Annotated[float, Field(ge=0, le=20)] | None = Field(
        default=None, description="Dryden intensity of gusts, m/s; none: as it was"
    )
    arc: _NotNegative | None = Field(
        default=None, description="where along the cable, m; none: about its middle"
    )
    friction: float | None = Field(
        default=None, gt=0, description="newtons above which a snag slides; none: it never does"
    )
    slide: Annotated[float, Field(ge=-1e4, le=1e4)] | None = Field(
        default=None,
        description="metres by which the grip moves along the cable; none: the cable leaves it",
    )

    @model_validator(mode="after")
    def _fits(self) -> "Fault":
        allowed = {"at", "kind", "vehicle", "duration", *KINDS[self.kind]}
        extra = sorted(self.model_fields_set - allowed)
        if extra:
            known = ", ".join(KINDS[self.kind]) or "nothing more"
            raise ValueError(f"{self.kind}: expected {known}, got {', '.join(extra)}")
        return self


class Scenario(BaseModel):
    """A scenario file."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal[1] = Field(default=1, alias="schema", description="version of this format")
    faults: list[Fault] = Field(description="faults, in any order")


def parse_scenario(text: str, name: str = "scenario") -> list[Fault]:
    """Turn a scenario file's text into faults; `WorldError` with every error."""
    data = parse_yaml(text, name)
    try:
        return Scenario.model_validate(data, by_alias=True, by_name=False).faults
    except ValidationError as error:
        raise WorldError(explain(error, name)) from None


def load_scenario(path: str | Path) -> list[Fault]:
    """Read a scenario file."""
    return parse_scenario(read_text(Path(path)), str(path))


class Dice:
    """Uniform random numbers from 0 to 1, drawn in blocks: the same as one by one, but quicker."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._left: list[float] = []

    def roll(self) -> float:
        """Return the next number."""
        return self.ready(1).pop()

    def ready(self, count: int) -> list[float]:
        """Return at least ``count`` numbers, to be taken from the end; what is left comes next."""
        left = self._left
        while len(left) < count:
            left[:0] = self._rng.random(_BLOCK)[::-1].tolist()
        return left


@dataclass
class Channel:
    """One direction of a vehicle's link, with its troubles; whole frames, in virtual time."""

    dice: Dice
    fault: Fault | None = None
    queue: list[tuple[float, int, Any]] = field(default_factory=list)
    count: int = 0
    free_at: float = 0.0
    outage: bool = False
    checked_at: float = 0.0
    _plain: tuple[float, float, float] | None = field(init=False)
    """Loss, latency and jitter, where these are all the troubles."""

    def __post_init__(self) -> None:
        self.suffer(self.fault)

    def suffer(self, fault: Fault | None) -> None:
        """Have a fault, or none, from now on."""
        self.fault, self._plain = fault, None
        if fault is not None and not (
            fault.burst or fault.reorder or fault.bandwidth or fault.duplicate
        ):
            self._plain = fault.loss, fault.latency, fault.jitter

    def push_all(self, items: Sequence[tuple[Any, ...]], now: float) -> None:
        """Send items that end with their frames into the channel, as `push` does one by one."""
        if self._plain is None:
            for item in items:
                self.push(item, len(item[-1]), now)
            return
        loss, latency, jitter = self._plain
        roll, queue = self.dice.ready(2 * len(items)).pop, self.queue
        count, soonest = self.count, now + latency
        for item in items:
            if loss > 0.0 and (loss >= 1.0 or roll() < loss):
                continue
            count += 1
            heappush(queue, (soonest + jitter * roll() if jitter else soonest, count, item))
        self.count = count

    def push(self, item: Any, size: int, now: float) -> None:
        """Send one frame into the channel."""
        fault, roll, at = self.fault, self.dice.roll, now
        if fault is not None:
            if fault.burst > 0.0:
                if self._in_burst(fault, now):
                    return
            elif fault.loss > 0.0 and (fault.loss >= 1.0 or roll() < fault.loss):
                return
            at += fault.latency + (fault.jitter * roll() if fault.jitter else 0.0)
            if fault.reorder and roll() < fault.reorder:
                at += 0.02 + fault.jitter
            if fault.bandwidth:
                self.free_at = max(self.free_at, now) + size / fault.bandwidth
                if self.free_at - now > 2.0:
                    self.free_at -= size / fault.bandwidth
                    return
                at += self.free_at - now
        self.count += 1
        heappush(self.queue, (at, self.count, item))
        if fault is not None and fault.duplicate and roll() < fault.duplicate:
            self.count += 1
            heappush(self.queue, (at + 0.01 * roll(), self.count, item))

    def _in_burst(self, fault: Fault, now: float) -> bool:
        """Whether a frame falls into a run of losses of mean length ``burst`` (Gilbert's model)."""
        if fault.loss >= 1.0:
            return True
        elapsed, self.checked_at = now - self.checked_at, now
        mean = (
            fault.burst if self.outage else fault.burst * (1 - fault.loss) / max(fault.loss, 1e-9)
        )
        if self.dice.roll() < 1 - math.exp(-elapsed / max(mean, 1e-6)):
            self.outage = not self.outage
        return self.outage

    def pop(self, now: float) -> list[Any]:
        """Take what has arrived by ``now``."""
        arrived: list[Any] = []
        queue, limit = self.queue, now + 1e-9
        while queue and queue[0][0] <= limit:
            arrived.append(heappop(queue)[2])
        return arrived
