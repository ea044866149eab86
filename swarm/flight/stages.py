"""The stages of a flight and of a contingency, and every transition between them, as tables.

As in h11: a state and an event lead to one next state; every other event is an error of the
program. :func:`mermaid` draws the tables.
"""

from collections.abc import Mapping
from enum import StrEnum


class Stage(StrEnum):
    """The stages of a flight.

    PREPARE: find the vehicles, request their streams and origins, wait for readiness. READY: wait
    for the audit and the operator. RESUME: find a team that flies already. EXECUTE: fly the plan.
    CONTINGENCY: land together outside the plan. FINISHED: nothing is sent any more.
    """

    PREPARE = "prepare"
    READY = "ready"
    RESUME = "resume"
    EXECUTE = "execute"
    CONTINGENCY = "contingency"
    FINISHED = "finished"


class CheckStep(StrEnum):
    """The steps of a check on the ground, which is no flight: nothing is armed.

    BODIES: a person moves one vehicle after the other. LINKS: the links are measured.
    """

    VEHICLES = "vehicles"
    BODIES = "bodies"
    PARAMETERS = "parameters"
    PLACES = "places"
    HOLD = "Hold mode"
    LINKS = "links"
    RESULT = "result"


class Trigger(StrEnum):
    """The events that change the stage of a flight."""

    TEAM_READY = "all vehicles are ready"
    CLEARED = "cleared for flight"
    TEAM_FOUND = "team found in flight"
    LEAVE_PLAN = "failure or operator"
    END = "outcome known"


TRANSITIONS: Mapping[Stage, Mapping[Trigger, Stage]] = {
    Stage.PREPARE: {Trigger.TEAM_READY: Stage.READY, Trigger.END: Stage.FINISHED},
    Stage.READY: {Trigger.CLEARED: Stage.EXECUTE, Trigger.END: Stage.FINISHED},
    Stage.RESUME: {Trigger.TEAM_FOUND: Stage.EXECUTE, Trigger.END: Stage.FINISHED},
    Stage.EXECUTE: {Trigger.LEAVE_PLAN: Stage.CONTINGENCY, Trigger.END: Stage.FINISHED},
    Stage.CONTINGENCY: {Trigger.END: Stage.FINISHED},
    Stage.FINISHED: {},
}


class Step(StrEnum):
    """The steps of a contingency.

    APPROACH: the clock comes to rest, at the nearest moment that permits the contingency. RELEASE:
    the grippers open. SEPARATE: the vehicles move apart. DESCEND: all go straight down.
    """

    APPROACH = "approach"
    RELEASE = "release"
    SEPARATE = "separate"
    DESCEND = "descend"


class StepTrigger(StrEnum):
    """The events that change the step of a contingency."""

    RELEASE = "release"
    RELEASED = "cable released"
    LAND = "land with the cable"
    STUCK = "grippers stay closed"
    SURROUNDED = "two vehicles do not follow"
    APART = "vehicles apart"


STEP_TRANSITIONS: Mapping[Step, Mapping[StepTrigger, Step]] = {
    Step.APPROACH: {StepTrigger.RELEASE: Step.RELEASE, StepTrigger.LAND: Step.DESCEND},
    Step.RELEASE: {
        StepTrigger.RELEASE: Step.RELEASE,
        StepTrigger.RELEASED: Step.SEPARATE,
        StepTrigger.STUCK: Step.DESCEND,
        StepTrigger.SURROUNDED: Step.DESCEND,
    },
    Step.SEPARATE: {StepTrigger.APART: Step.DESCEND},
    Step.DESCEND: {StepTrigger.RELEASE: Step.RELEASE},
}


def next_stage(stage: Stage, trigger: Trigger) -> Stage:
    """Return the stage that follows; raises ValueError where the table has none."""
    if trigger not in TRANSITIONS[stage]:
        raise ValueError(f"no transition from {stage.name} by {trigger.name}")
    return TRANSITIONS[stage][trigger]


def next_step(step: Step, trigger: StepTrigger) -> Step:
    """Return the step that follows; raises ValueError where the table has none."""
    if trigger not in STEP_TRANSITIONS[step]:
        raise ValueError(f"no transition from {step.name} by {trigger.name}")
    return STEP_TRANSITIONS[step][trigger]


def mermaid() -> str:
    """Return both tables as one Mermaid state diagram."""
    lines = ["stateDiagram-v2", "    [*] --> PREPARE", "    [*] --> RESUME"]
    for stage, row in TRANSITIONS.items():
        lines += [f"    {stage.name} --> {after.name}: {by.value}" for by, after in row.items()]
    lines += ["    FINISHED --> [*]", "    state CONTINGENCY {", "        [*] --> APPROACH"]
    for step, way in STEP_TRANSITIONS.items():
        lines += [f"        {step.name} --> {to.name}: {by.value}" for by, to in way.items()]
    lines += ["        DESCEND --> [*]", "    }"]
    return "\n".join(lines)
