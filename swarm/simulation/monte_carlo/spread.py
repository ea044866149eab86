"""What is drawn anew for every trial, and from which distributions."""

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


FailureKind = Literal[
    "motor_loss", "weak_thrust", "link", "leave_offboard", "gripper_slip", "freeze", "reboot",
    "gripper_stuck_open", "gripper_stuck_shut", "gps_loss", "position_loss", "disarm", "pilot",
    "believes_landed", "barometer_drift", "gps_jump", "battery",
]  # fmt: skip

FAILURES: Final[tuple[FailureKind, ...]] = (
    "motor_loss", "weak_thrust", "link", "leave_offboard", "gripper_slip", "freeze", "reboot",
)  # fmt: skip


class Spread(Section):
    """What is drawn anew for every trial, and from which distributions."""

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
        0.05, "", "Standard deviation of a vehicle's mass as a share of vehicles.mass, which is "
        "what makes vehicles track differently; cut off at twice this.",
        least=0.0, most=0.4,
    )  # fmt: skip
    grip: float = number(
        0.01, "metres", "Standard deviation of where along the cable each vehicle grips; cut off "
        "at twice this.",
        least=0.0, most=1.0,
    )  # fmt: skip
    length: float = number(
        1.0, "", "Error of each segment's length: uniform within this many cable.length_tolerance.",
        least=0.0, most=100.0,
    )  # fmt: skip
    failing: float = number(
        0.1, "", "Share of trials in which one vehicle fails, in one of the ways of `failures`.",
        least=0.0, most=1.0,
    )  # fmt: skip
    failures: tuple[FailureKind, ...] = Field(
        FAILURES, description="Kinds of failure, as in `faults`; all equally likely."
    )


def read_scenario(text: str, source: str) -> tuple[Spread, tuple[Fault, ...]]:
    """Turn a scenario file's text into what is drawn for trials and the faults of every trial.

    It is the emulator's scenario, in which ``spread`` may say more. Raises :class:`InputError` with
    every problem.
    """
    document = parse_yaml(text, source)
    if not isinstance(document, dict):
        raise InputError([Problem(source, "expected keys: schema, faults, spread")])
    faults = {key: value for key, value in document.items() if key != "spread"}
    spread = validate(Spread, document.get("spread") or {}, f"{source}: spread")
    return spread, faults_from(json.dumps({"faults": [], **faults}, default=str), source)


def trial_scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files with ``spread``, for editors."""
    schema = scenario_schema()
    spread = Spread.model_json_schema(by_alias=True)
    schema["properties"]["spread"] = {
        **spread, "description": "What trials draw anew each time; the rest keeps its default.",
    }  # fmt: skip
    schema["required"] = [key for key in schema.get("required", []) if key != "faults"]
    return schema


@dataclass(frozen=True)
class Conditions:
    """What was drawn for one trial: the emulator's world, its faults, and both in short.

    ``wind`` in m/s, ``failing`` names the vehicle that fails and how ("" where none does),
    ``failing_at`` is the flight's time of it in seconds.
    """

    world: Mapping[str, Any]
    faults: tuple[Fault, ...]
    wind: float
    gust: float
    failing: str
    failing_at: float | None


def draw(
    plan: Plan, fleet: Fleet, spread: Spread, seed: int, trial: int, faults: Sequence[Fault] = ()
) -> Conditions:
    """Draw the conditions of a trial; the same seed and number give the same ones.

    ``faults`` happen in every trial, beside what is drawn.
    """
    rng = np.random.default_rng([seed, trial])
    mission = plan.mission
    count = plan.vehicles
    tolerance = spread.length * mission.cable.length_tolerance
    grips = _bounded(rng, spread.grip, count)
    lengths = plan.layout.lengths + tolerance * rng.uniform(-1.0, 1.0, count - 1) + np.diff(grips)
    laid = replace(plan, layout=replace(plan.layout, lengths=lengths))
    world = emulated_world(laid, fleet, with_cable=True, seed=int(rng.integers(2**31)))
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
        trouble = {
            name: float(rng.uniform(0.0, getattr(spread, name)))
            for name in ("loss", "latency", "jitter")
        }
        if any(trouble.values()):
            drawn.append(Fault(at=0.0, kind="link", vehicle=vehicle["id"], **trouble))
    failing = _failure(plan, fleet, spread, rng)
    if failing is not None:
        drawn.append(failing)
    return Conditions(
        world=world,
        faults=tuple(drawn),
        wind=speed,
        gust=gust,
        failing=f"vehicle {failing.vehicle}: {failing.kind}" if failing else "",
        failing_at=failing.at if failing else None,
    )


def _bounded(rng: Random, sigma: float, count: int) -> Floats:
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
