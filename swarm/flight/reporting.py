"""A flight in words and numbers, for displays and records; what it waits for, and how long."""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from swarm.certification.findings import numbers
from swarm.flight.execute import airborne, at_rest, releasing
from swarm.flight.pace import slowed_by
from swarm.flight.preparation import problems_of, readiness
from swarm.flight.responding import available
from swarm.flight.result import Statistics
from swarm.flight.snapshot import Snapshot
from swarm.flight.stages import Stage, Step
from swarm.flight.state import FlightState
from swarm.flight.streams import outside
from swarm.mavlink.vehicle import Vehicle
from swarm.planning import Condition, Gate

GATE_WORDS: Final[Mapping[Condition, str]] = {
    "armed": "arm",
    "airborne": "be airborne",
    "gripped": "grip the cable",
    "settled": "come to rest at their setpoints",
    "released": "release the cable",
    "landed": "land and disarm",
}
"""What all vehicles have to do at a gate."""

STEP_WORDS: Final[Mapping[Step, str]] = {
    Step.APPROACH: "the clock to stop where all can come down",
    Step.RELEASE: "the grippers to open",
    Step.SEPARATE: "the vehicles to move apart",
    Step.DESCEND: "all vehicles to be down and disarmed",
}
"""What a team outside the plan waits for."""


def waiting_for(flight: FlightState) -> str | None:
    """Return what the mission clock waits for, for use after "waiting for"; None where it runs.

    A hold is not part of it.
    """
    if flight.stage is Stage.PREPARE:
        return _preparation(flight)
    if flight.stage is Stage.READY:
        step = f" ({flight.ground_check})" if flight.ground_check else ""
        return f"the ground check{step} and the go"
    if flight.contingency is not None and flight.stage is Stage.CONTINGENCY:
        return STEP_WORDS[flight.contingency.step]
    gate = flight.gate
    if flight.stage is not Stage.EXECUTE or not flight.progress.waiting or gate is None:
        return None
    who = "all inner vehicles" if gate.inner else "all vehicles"
    return f"{who} to {GATE_WORDS[gate.condition]} ({gate_name(flight, gate)})"


def gate_name(flight: FlightState, gate: Gate) -> str:
    """Return the name of a gate by the phase that begins behind it."""
    plan = flight.setup.plan
    if gate.time >= plan.duration - 1e-6:
        return "gate at the end"
    return f"gate before {plan.phase_at(gate.time + 1e-6).name}"


def _preparation(flight: FlightState) -> str:
    if not flight.preparation.all_received:
        silent = _of(flight, lambda vehicle: not flight.received(vehicle))
        return f"heartbeats of {silent}" if silent else "heartbeats of all vehicles"
    unready = _of(
        flight, lambda vehicle: bool(readiness([vehicle], flight.setup.fleet, flight.now))
    )
    return f"{unready} to be ready" if unready else "all vehicles to be ready"


def _of(flight: FlightState, condition: Callable[[Vehicle], bool]) -> str:
    which = [k for k, vehicle in enumerate(flight.roster.vehicles, 1) if condition(vehicle)]
    return f"vehicle{'s' if len(which) > 1 else ''} {numbers(which)}" if which else ""


def missing(flight: FlightState) -> tuple[int, ...]:
    """Return the numbers, from 1, of the vehicles that the mission clock waits for."""
    vehicles, gate = flight.roster.vehicles, flight.gate
    armed = np.array([vehicle.armed for vehicle in vehicles])
    lacking = np.zeros(len(vehicles), dtype=np.bool_)
    if flight.stage is Stage.PREPARE:
        lacking = np.array([bool(text) for text in problems(flight)])
    elif flight.contingency is not None and flight.contingency.step is Step.DESCEND:
        lacking = armed
    elif flight.stage is Stage.EXECUTE and flight.progress.waiting and gate is not None:
        gripped = np.array([vehicle.gripped for vehicle in vehicles])
        concerned = {vehicle.system for vehicle in releasing(flight)}
        inner = np.array([vehicle.system in concerned for vehicle in vehicles])
        lacking = {
            "armed": ~(armed & flight.streams.active),
            "airborne": ~airborne(flight),
            "gripped": ~gripped,
            "settled": ~at_rest(flight),
            "released": gripped & inner,
            "landed": armed,
        }[gate.condition]
    return tuple((np.flatnonzero(lacking) + 1).tolist())


def problems(flight: FlightState) -> tuple[str, ...]:
    """Return why each vehicle is not ready, or does not follow the plan; "" where nothing is wrong.

    What the other values of a snapshot say, as its tracking error, is not repeated.
    """
    vehicles = flight.roster.vehicles
    if flight.stage in {Stage.PREPARE, Stage.READY}:
        return tuple(
            "; ".join(text for _, text in problems_of(vehicle, flight.setup.fleet, flight.now))
            for vehicle in vehicles
        )
    if flight.stage is not Stage.EXECUTE:
        return ("",) * len(vehicles)
    gate, waiting = flight.gate, flight.progress.waiting
    by_themselves = waiting and gate is not None and gate.condition in {"armed", "landed"}
    away = [] if by_themselves else outside(flight)
    return tuple(
        "has fallen, and is given up"
        if k in flight.streams.fallen
        else "gets no setpoints"
        if k in away
        else ""
        for k in range(len(vehicles))
    )


def held(flight: FlightState) -> str | None:
    """Return why the team holds; None where it does not, or has left the plan."""
    return flight.holds.message if flight.stage is Stage.EXECUTE else None


def time_left(flight: FlightState) -> float | None:
    """Return the seconds until a wait ends by itself; None where nothing waits.

    After a hold all vehicles land together; after a gate's timeout the table of failures decides.
    """
    since = flight.detectors.hold_timeout.since
    if held(flight) is not None:
        held_for = 0.0 if since is None else flight.now - since
        return max(flight.setup.fleet.limits.hold - held_for, 0.0)
    gate = flight.gate
    if flight.stage is Stage.EXECUTE and flight.progress.waiting and gate is not None:
        return max(gate.timeout - (flight.now - flight.progress.gate_since), 0.0)
    return None


def remaining(flight: FlightState) -> float | None:
    """Return the seconds to the end of the plan at the clock's rate limits; None outside the plan.

    Time at gates, in holds and for vehicles that lag is not part of it.
    """
    if flight.stage is not Stage.EXECUTE:
        return None
    time = flight.clock.time
    return flight.setup.plan.duration - time + flight.stream_loss.delay_after(time)


def landing(flight: FlightState) -> float | None:
    """Return the seconds in which all are expected to have landed as planned.

    With waits at the gates to come, as :attr:`Plan.expected_waits`, and a clock that slows before
    the fold ends. None outside the plan, and in a hold, which may last for any time.
    """
    remainder, time, plan = remaining(flight), flight.clock.time, flight.setup.plan
    if remainder is None or flight.holds.causes or flight.progress.rewinding:
        return None
    waits = [plan.expected_wait(gate) for gate in flight.setup.gates[flight.progress.gate :]]
    if flight.progress.waiting and waits:
        waits[0] = max(waits[0] - (flight.now - flight.progress.gate_since), 0.0)
    folds = any(phase.name == "fold" and time < phase.end for phase in plan.phases)
    return remainder + sum(waits) + (plan.expected_slowing if folds else 0.0)


def windows(flight: FlightState) -> dict[str, float | None]:
    """Return the mission time until all can land together, and release the cable: 0 now, None not
    in the rest of the plan; none of both outside the plan."""
    times: dict[str, float | None] = {}
    if flight.stage is not Stage.EXECUTE or flight.contingency is not None:
        return times
    time, of = flight.clock.time, flight.setup.windows
    now = {"land": of.can_land(time), "release": of.can_release(time)}
    for name, flags in (("land", of.land), ("release", of.release)):
        later = of.time[flags & (of.time > time)]
        times[name] = 0.0 if now[name] else float(later[0] - time) if len(later) else None
    if not flight.attached:
        times.pop("release")
    return times


TRACE_INTERVAL = 0.1
"""Seconds between recorded samples: at 2 m/s 0.2 m, which pages draw as a curve."""
FRESH_IN_TRACE = 1.0
"""Seconds after which a position is recorded as unknown: it would be drawn at rest."""


def record_sample(flight: FlightState) -> None:
    """Record the positions and setpoints of this moment, ten times a second."""
    recorder, seen = flight.recorder, flight.observation
    if flight.placement.frames is None or flight.now < recorder.next_sample:
        return
    recorder.next_sample = flight.now + TRACE_INTERVAL
    phase = flight.phase.name if flight.stage is Stage.EXECUTE else ""
    position = seen.position.copy()
    position[flight.now - seen.measured.at > FRESH_IN_TRACE] = np.nan
    setpoint = flight.streams.setpoint.copy()
    swing = flight.swing if flight.stage is Stage.EXECUTE else None
    stray = swing.stray if swing else np.full(len(flight.setup.plan.layout.lengths), np.nan)
    recorder.sample((flight.now, flight.clock.time), (position, setpoint), phase, stray)


def snapshot_of(flight: FlightState, now: float) -> Snapshot:
    """Return the flight at this moment."""
    vehicles, seen = flight.roster.vehicles, flight.observation
    swing = flight.swing if flight.stage is Stage.EXECUTE else None
    return Snapshot(
        time=now,
        mission_time=flight.clock.time,
        rate=flight.clock.rate,
        phase=flight.phase.name if flight.stage is Stage.EXECUTE else flight.stage.value,
        waiting_for=waiting_for(flight),
        position=seen.position.copy(),
        velocity=seen.velocity.copy(),
        setpoint=flight.streams.setpoint.copy(),
        modes=tuple(vehicle.mode for vehicle in vehicles),
        states=tuple(_state(flight, vehicle) for vehicle in vehicles),
        armed=tuple(vehicle.armed for vehicle in vehicles),
        gripped=tuple(vehicle.gripped for vehicle in vehicles),
        battery=np.array([vehicle.battery for vehicle in vehicles]),
        link_age=np.array([max(now - vehicle.received_at, 0.0) for vehicle in vehicles]),
        clearances=flight.clearances,
        available={name: (entry.open, entry.words) for name, entry in available(flight).items()},
        round_trip=np.array([vehicle.latest_round_trip for vehicle in vehicles]),
        received=np.array([float(vehicle.packets) for vehicle in vehicles]),
        lost=np.array([float(vehicle.lost_packets) for vehicle in vehicles]),
        held=held(flight),
        time_left=time_left(flight),
        remaining=remaining(flight),
        stray=swing.stray if swing else None,
        cable=swing.states[1] if swing else None,
        problems=problems(flight),
        missing=missing(flight),
        voltage=np.array([vehicle.voltage for vehicle in vehicles]),
        fix=np.array([float(vehicle.fix_type) for vehicle in vehicles]),
        satellites=np.array([float(vehicle.satellites) for vehicle in vehicles]),
        position_age=np.array([now - vehicle.position_at for vehicle in vehicles]),
        landing=landing(flight),
        windows=windows(flight),
        slowed_by=slowed_by(flight) if flight.stage is Stage.EXECUTE else "",
    )


def statistics_of(flight: FlightState) -> Statistics:
    """Return the statistics of a flight's links so far."""
    latencies = np.array([x for v in flight.roster.vehicles for x in v.commands.latencies])
    known = len(latencies) > 0
    return Statistics(
        duration=flight.now,
        setpoints=flight.streams.sent,
        command_latency=(float(np.median(latencies)), float(latencies.max())) if known else None,
        received={v.system: v.packets for v in flight.roster.vehicles},
        lost={v.system: v.lost_packets for v in flight.roster.vehicles},
        round_trip={v.system: v.round_trip for v in flight.roster.vehicles},
        rejected=_rejected(flight),
        gap=(flight.timing.gap, flight.timing.gap_at),
    )


def _rejected(flight: FlightState) -> dict[str, int]:
    by_signature = dict(flight.team.signing.dropped) if flight.team.signing else {}
    others = flight.team.rejected - sum(by_signature.values())
    return {**{str(kind): count for kind, count in by_signature.items()}, "stranger": others}


def _state(flight: FlightState, vehicle: Vehicle) -> str:
    if not flight.received(vehicle):
        return "silent"
    if not vehicle.armed:
        return "ready" if vehicle.ready else "waiting"
    return "on the ground" if vehicle.on_ground else "flying"
