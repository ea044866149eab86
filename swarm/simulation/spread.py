"""The distributions from which the conditions of each trial are drawn."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from swarm.errors import InputError, Problem
from swarm.flight.world import emulated_world
from swarm.mission.fleet import Fleet
from swarm.mission.validation import Section, number, parse_yaml, validate
from swarm.planning import Plan
from swarm.simulation.loop import Fault, faults_from, scenario_schema

Floats = npt.NDArray[np.float64]
Random = np.random.Generator

_BOOT: Final = 30.0
"""Seconds of start-up before the plan, in which a failure may occur as well."""

FaultKind = Literal[
    "motor_loss", "weak_thrust", "link", "leave_offboard", "gripper_slip", "freeze", "reboot",
    "gripper_stuck_open", "gripper_stuck_shut", "gps_loss", "position_loss", "disarm", "pilot",
    "believes_landed", "barometer_drift", "gps_jump", "battery",
]  # fmt: skip

FAILURES: Final[tuple[FaultKind, ...]] = (
    "motor_loss", "weak_thrust", "link", "leave_offboard", "gripper_slip", "freeze", "reboot",
)  # fmt: skip


class Spread(Section):
    """The distributions from which the conditions of each trial are drawn."""

    wind: float = number(
        0.5, "m/s", "Steady wind: uniform from 0 to this (or wind.steady, if larger), any heading.",
        least=0.0, most=20.0,
    )  # fmt: skip
    gust: float = number(
        0.2, "m/s", "Dryden intensity of gusts: uniform from 0 to this (or wind.gust, if larger).",
        least=0.0, most=10.0,
    )  # fmt: skip
    loss: float = number(
        0.02, "", "Share of packets that a vehicle's link loses: uniform from 0 to this, each.",
        least=0.0, most=1.0,
    )  # fmt: skip
    latency: float = number(
        0.03, "s", "Delay of a vehicle's link, each way: uniform from 0 to this, each.",
        least=0.0, most=5.0,
    )  # fmt: skip
    jitter: float = number(
        0.02, "s", "Spread of that delay from packet to packet: uniform from 0 to this, each.",
        least=0.0, most=5.0,
    )  # fmt: skip
    mass: float = number(
        0.05, "", "Standard deviation of a vehicle's mass as a share of vehicles.mass, so that "
        "vehicles track differently; cut off at twice this.",
        least=0.0, most=0.4,
    )  # fmt: skip
    grip: float = number(
        0.01, "metres", "Standard deviation of each grip's position along the cable; cut off at "
        "twice this.",
        least=0.0, most=1.0,
    )  # fmt: skip
    length: float = number(
        1.0, "", "Error of each segment's length: uniform within this many cable.length_tolerance.",
        least=0.0, most=100.0,
    )  # fmt: skip
    failing: float = number(
        0.1, "", "Share of trials in which one vehicle fails; `failures` lists the kinds.",
        least=0.0, most=1.0,
    )  # fmt: skip
    failures: tuple[FaultKind, ...] = Field(
        FAILURES, description="Kinds of failure, as in `faults`; all equally likely."
    )


def unit(key: str) -> str:
    """Return the unit of a key of :class:`Spread`; "" for a share and for kinds."""
    extra = Spread.model_fields[key].json_schema_extra
    words = extra.get("unit") if isinstance(extra, dict) else ""
    return {"metres": "m"}.get(str(words), str(words or ""))


def read_scenario(text: str, source: str) -> tuple[Spread, tuple[Fault, ...]]:
    """Return the spread of a scenario file and the faults that occur in every trial.

    The file is the emulator's scenario with the additional key ``spread``. Raises
    :class:`InputError` with every problem.
    """
    document = parse_yaml(text, source)
    if not isinstance(document, dict):
        raise InputError([Problem(source, "expected keys: schema, faults, spread")])
    faults = {key: value for key, value in document.items() if key != "spread"}
    spread = validate(Spread, document.get("spread") or {}, f"{source}: spread")
    try:
        text = json.dumps({"faults": [], **faults}, default=str)
    except (TypeError, ValueError) as error:  # keys that are lists, numbers of thousands of digits
        raise InputError([Problem(source, str(error))]) from None
    return spread, faults_from(text, source)


def trial_scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files with ``spread``, for editors."""
    schema = scenario_schema()
    spread = Spread.model_json_schema(by_alias=True)
    schema["properties"]["spread"] = {
        **spread, "description": "What each trial draws anew; missing keys keep their defaults.",
    }  # fmt: skip
    schema["required"] = [key for key in schema.get("required", []) if key != "faults"]
    return schema


@dataclass(frozen=True)
class Conditions:
    """The conditions of one trial: the emulator's world and its faults.

    ``wind`` is the steady wind and ``gust`` the intensity of gusts, m/s; ``failure`` is the vehicle
    that fails and the kind of failure ("" for none), ``failure_time`` in seconds of flight.
    """

    world: Mapping[str, Any]
    faults: tuple[Fault, ...]
    wind: float
    gust: float
    failure: str
    failure_time: float | None


def draw(
    plan: Plan, fleet: Fleet, spread: Spread, seed: int, trial: int, faults: Sequence[Fault] = ()
) -> Conditions:
    """Return the conditions of a trial; the same seed and number give the same conditions.

    ``faults`` occur in every trial, in addition to the drawn ones.
    """
    rng = np.random.default_rng([seed, trial])
    mission = plan.mission
    count = plan.vehicles
    tolerance = spread.length * mission.cable.length_tolerance
    grips = _bounded(rng, spread.grip, count)
    segments = len(plan.layout.lengths)
    lengths = plan.layout.lengths + tolerance * rng.uniform(-1.0, 1.0, segments)
    lengths += np.diff(grips)[:segments]
    laid_plan = replace(plan, layout=replace(plan.layout, lengths=lengths))
    world = emulated_world(laid_plan, fleet, with_cable=True, seed=int(rng.integers(2**31)))
    speed = float(rng.uniform(0.0, max(spread.wind, mission.wind.steady)))
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    gust = float(rng.uniform(0.0, max(spread.gust, mission.wind.gust)))
    world["wind"] = {
        "steady": [speed * math.cos(heading), speed * math.sin(heading), 0.0],
        "gust": gust,
    }
    drawn = list(faults)
    for vehicle, share in zip(world["vehicles"], _bounded(rng, spread.mass, count), strict=True):
        vehicle["mass"] *= 1.0 + float(share)
        link = {
            name: float(rng.uniform(0.0, getattr(spread, name)))
            for name in ("loss", "latency", "jitter")
        }
        if any(link.values()):
            drawn.append(Fault(at=0.0, kind="link", vehicle=vehicle["id"], **link))
    failure = _failure(plan, fleet, spread, rng)
    if failure is not None:
        drawn.append(failure)
    return Conditions(
        world=world,
        faults=tuple(drawn),
        wind=speed,
        gust=gust,
        failure=f"vehicle {failure.vehicle}: {failure.kind}" if failure else "",
        failure_time=failure.at if failure else None,
    )


def _bounded(rng: Random, sigma: float, count: int) -> Floats:
    """Return normal deviates (count,) that are cut off at two standard deviations."""
    return np.clip(rng.normal(0.0, sigma, count), -2.0 * sigma, 2.0 * sigma)


def _failure(plan: Plan, fleet: Fleet, spread: Spread, rng: Random) -> Fault | None:
    if rng.uniform() >= spread.failing or not spread.failures:
        return None
    kind = str(rng.choice(spread.failures))
    details: dict[str, Any] = {
        "weak_thrust": {"fraction": float(rng.uniform(0.4, 0.9))},
        "link": {"loss": 1.0, "duration": float(rng.uniform(0.5, 10.0))},
        "freeze": {"duration": float(rng.uniform(0.5, 10.0))},
    }.get(kind, {})
    return Fault(
        at=float(rng.uniform(0.0, plan.duration + _BOOT)),
        kind=kind,
        vehicle=int(rng.choice(fleet.systems[: plan.vehicles])),
        **details,
    )
