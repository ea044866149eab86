"""Scenario files: faults of vehicles and links, with their times.

    schema: 1
    faults:
      - {at: 12.0, kind: weak_thrust, vehicle: 3, fraction: 0.7, duration: 5.0}
      - {at: 20.0, kind: link, vehicle: all, loss: 0.2, latency: 0.3, jitter: 0.1}

Times are emulated seconds since the start. A fault without ``duration`` is permanent.
``MAV_CMD_INJECT_FAILURE`` (for external test tools) and ``SIM_*`` parameters inject the same
faults: see `sitl.faults.injector`.

A frozen autopilot receives nothing, sends nothing and checks no timers; its controller continues
with the last goal. A rebooting one stops its motors. ``rc_loss`` has an effect if the world file
gives a vehicle a ``radio``. ``snag`` holds the cable at its present place by friction on other
cable: it falls when no vehicle holds the cable.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sitl.world import WorldError, explain, parse_yaml, read_text

_Metres = Annotated[float, Field(ge=-1e4, le=1e4)]
_Wind = Annotated[float, Field(ge=-100.0, le=100.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_NotNegative = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]
_Seconds = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]
_Delay = Annotated[float, Field(ge=0.0, le=60.0, allow_inf_nan=False)]

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
"""Keys of each kind of fault, beside at, kind, vehicle and duration."""
WORLDWIDE = frozenset({"wind", "snag"})
"""Kinds that concern no single vehicle."""

REACHABLE = frozenset(
    {"motor_loss", "weak_thrust", "gripper_stuck_open", "gripper_stuck_shut", "gripper_slip"}
)
"""Kinds that the world can cause in a vehicle with real firmware: those of bodies and grippers."""
SENSORS = frozenset({"gps_loss", "gps_jump", "barometer_drift"})
"""Kinds that it can cause where it simulates the sensors too: with PX4's firmware."""


class Fault(BaseModel):
    """One fault: start, kind, vehicles, duration, severity."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at: _Seconds = Field(description="start, emulated seconds since the start")
    kind: Literal[tuple(KINDS)] = Field(  # type: ignore[valid-type]
        description="kind of fault; each kind has its own keys"
    )
    vehicle: int | list[int] | Literal["all"] = Field(
        default="all", description="system ids of the vehicles; without effect for wind and snag"
    )
    duration: _Seconds | None = Field(default=None, description="s; none: permanent")
    loss: _Share = Field(default=0.0, description="share of packets that are lost")
    burst: _Seconds = Field(default=0.0, description="mean length of a burst of losses, s")
    latency: _Delay = Field(default=0.0, description="delay of every packet, s")
    jitter: _Delay = Field(
        default=0.0, description="additional delay, s: uniform from 0 to this for each packet"
    )
    duplicate: _Share = Field(default=0.0, description="share of packets that arrive twice")
    reorder: _Share = Field(
        default=0.0, description="share of packets that later packets may overtake"
    )
    bandwidth: float | None = Field(default=None, gt=0, description="bytes per second")
    direction: Literal["up", "down", "both"] = Field(
        default="both", description="up: to the vehicle, down: from it"
    )
    fraction: Annotated[float, Field(ge=0.0, le=2.0)] = Field(
        default=0.7, description="remaining share of the thrust, or of the clock's rate"
    )
    charge: _Share = Field(default=0.1, description="remaining share of the battery's charge")
    offset: tuple[_Metres, _Metres, _Metres] = Field(
        default=(5.0, 0.0, 0.0), description="metres by which the position or origin jumps, ENU"
    )
    rate: Annotated[float, Field(ge=-5, le=5)] = Field(
        default=0.1, description="drift of the barometer's height, m/s"
    )
    text: Annotated[str, Field(max_length=100)] = Field(
        default="Resolve system health failures first",
        description="reason of the refusal",
    )
    steady: tuple[_Wind, _Wind, _Wind] | None = Field(
        default=None,
        description="steady wind, m/s, ENU, to where it blows; none: unchanged",
    )
    gust: Annotated[float, Field(ge=0, le=20)] | None = Field(
        default=None, description="Dryden intensity of gusts, m/s; none: unchanged"
    )
    arc: _NotNegative | None = Field(
        default=None, description="arc length along the cable, m; none: near its middle"
    )
    friction: float | None = Field(
        default=None,
        gt=0,
        description="newtons above which a snag slides; none: it never slides",
    )
    slide: _Metres | None = Field(
        default=None,
        description="metres by which the grip moves along the cable; none: the cable leaves it",
    )

    @model_validator(mode="after")
    def _fits(self) -> "Fault":
        allowed = {"at", "kind", "vehicle", "duration", *KINDS[self.kind]}
        extra = sorted(self.model_fields_set - allowed)
        if extra:
            known = ", ".join(KINDS[self.kind]) or "no further keys"
            raise ValueError(f"{self.kind}: expected {known}, got {', '.join(extra)}")
        return self


class Scenario(BaseModel):
    """A scenario file."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal[1] = Field(default=1, alias="schema", description="version of this format")
    faults: list[Fault] = Field(description="faults, in any order")


def parse_scenario(text: str, name: str = "scenario") -> list[Fault]:
    """Return the faults in the text of a scenario file; raise `WorldError` with every error."""
    data = parse_yaml(text, name)
    try:
        return Scenario.model_validate(data, by_alias=True, by_name=False).faults
    except ValidationError as error:
        raise WorldError(explain(error, name)) from None


def load_scenario(path: str | Path) -> list[Fault]:
    """Return the faults of a scenario file; raise `WorldError` with every error."""
    return parse_scenario(read_text(Path(path)), str(path))
