"""A training flight: which faults were injected into emulated vehicles, and who reacted when."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from swarm.errors import Refused
from swarm.flight.requests import ABSENCE, requested
from swarm.flight.snapshot import Event
from swarm.mission.fleet import Fleet

_TEAM = frozenset({"hold", "contingency"})
"""Kinds of events with what the team does."""


@dataclass(frozen=True)
class InjectedFault:
    """A fault that begins at ``time`` and lasts ``duration`` seconds (None: to the end).

    ``kind`` and ``details`` are words. ``vehicles`` are counted from 1; none for a fault of the
    world, as wind.
    """

    time: float
    kind: str
    details: str
    vehicles: tuple[int, ...]
    duration: float | None


@dataclass(frozen=True)
class Training:
    """The scenario of a training flight.

    ``scenario`` is the name of its file, ``digest`` the SHA-256 of it; the times of its ``faults``
    are seconds since the emulated world began, or since the record did. ``document`` is what the
    emulator gets.
    """

    scenario: str
    digest: str
    faults: tuple[InjectedFault, ...]
    document: Mapping[str, Any]

    @property
    def words(self) -> str:
        """What the record says first."""
        return f"training: {self.scenario} injects faults (SHA-256 {self.digest[:12]}…)"

    def recorded_from(self, moment: float) -> "Training":
        """Return the same with times since a record began, at a moment of the world in seconds."""
        faults = tuple(replace(fault, time=fault.time - moment) for fault in self.faults)
        return replace(self, faults=faults)


def require_emulated(fleet: Fleet | None) -> None:
    """Raise :class:`Refused` where a scenario's faults cannot be injected: in real vehicles.

    None stands for the built-in emulator.
    """
    if fleet is not None and fleet.emulated is None:
        raise Refused(
            f"--scenario: the vehicles of fleet {fleet.name} are not emulated; faults are injected "
            "by the built-in emulator only"
        )


@dataclass(frozen=True)
class Reaction:
    """What followed a fault.

    ``began``: whether it began before the flight ended. ``detected`` is the first failure that the
    ground station reported of its vehicles, ``team`` what the team then did by itself, ``request``
    the first request of an operator; the latter two before the next fault began.
    """

    fault: InjectedFault
    began: bool
    detected: Event | None
    team: tuple[Event, ...]
    request: Event | None

    @property
    def reaction_time(self) -> float | None:
        """Seconds from the detection to the request; from the fault where it came before that."""
        if self.request is None:
            return None
        since = self.detected.time if self.warned and self.detected else self.fault.time
        return self.request.time - since

    @property
    def warned(self) -> bool:
        """Whether the request came after the ground station had reported the fault."""
        seen, made = self.detected, self.request
        return seen is not None and made is not None and seen.time <= made.time


def reactions(training: Training, events: Sequence[Event]) -> tuple[Reaction, ...]:
    """Return what followed each fault of a flight, in the order of their beginnings.

    The times of faults and ``events`` are seconds since the record began.
    """
    end = max((event.time for event in events), default=0.0)
    ordered = sorted(training.faults, key=lambda fault: fault.time)
    own = _own_reactions(events)
    outcomes = []
    for fault in ordered:
        later = [other for other in ordered if other.time > fault.time]
        until = min((other.time for other in later), default=float("inf"))
        same = [other.time for other in later if _concerned(fault, other.vehicles)]
        detected = _first(
            event
            for event in _between(events, fault.time, min(same, default=float("inf")))
            if event.kind == "failure"
            and (event.vehicle is None or _concerned(fault, (event.vehicle,)))
        )
        request = _first(
            event for event in _between(events, fault.time, until) if _made_by_operator(event)
        )
        team = tuple(_between(own, fault.time, until))
        outcomes.append(Reaction(fault, fault.time < end, detected, team, request))
    return tuple(outcomes)


def _concerned(fault: InjectedFault, vehicles: Sequence[int]) -> bool:
    """Return whether a fault may show at one of these vehicles; one of the world at all."""
    return not fault.vehicles or not vehicles or bool({*fault.vehicles} & {*vehicles})


def _between(events: Iterable[Event], since: float, until: float) -> list[Event]:
    return [event for event in events if since <= event.time < until]


def _first(events: Iterable[Event]) -> Event | None:
    return next(iter(events), None)


def _made_by_operator(event: Event) -> bool:
    made = requested(event)
    return made is not None and made[1] != ABSENCE


def _own_reactions(events: Iterable[Event]) -> list[Event]:
    """Return what the team did by itself: not in the moment after an operator's request."""
    own, asked = [], -1.0
    for event in events:
        if requested(event) is not None:
            asked = event.time
        elif event.kind in _TEAM and event.time != asked:
            own.append(event)
    return own


def training_object(training: Training | None, events: Sequence[Event]) -> dict[str, Any] | None:
    """Return the faults of a training flight and the reactions to them, for JSON; seconds."""
    if training is None:
        return None
    return {
        "scenario": training.scenario,
        "digest": training.digest,
        "faults": [_reaction_object(reaction) for reaction in reactions(training, events)],
    }


def _reaction_object(reaction: Reaction) -> dict[str, Any]:
    fault, request = reaction.fault, reaction.request
    command, author = (requested(request) if request else None) or ("", "")
    return {
        **asdict(fault),
        "vehicles": list(fault.vehicles),
        "began": reaction.began,
        "detected": _event_object(reaction.detected, fault),
        "team": [_event_object(event, fault) for event in reaction.team],
        "operator": None
        if request is None
        else {
            **(_event_object(request, fault) or {}),
            "request": command,
            "author": author,
            "reaction_time": reaction.reaction_time,
            "since": "detection" if reaction.warned else "fault",
        },
    }


def _event_object(event: Event | None, fault: InjectedFault) -> dict[str, Any] | None:
    if event is None:
        return None
    return {"time": event.time, "after": event.time - fault.time, "message": event.message}
