"""Failure detection: the observed team against the commanded one, each detector by itself."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from swarm.flight.detect.grip_slip import GripSlipDetector
from swarm.flight.detect.health import HealthDetector
from swarm.flight.detect.heights import Floats, HeightDetector
from swarm.flight.detect.latch import Latch
from swarm.flight.detect.links import LinkDetector
from swarm.flight.detect.motion import MotionDetector
from swarm.flight.detect.reports import ReportDetector
from swarm.flight.detect.standstill import (
    BlockedDetector,
    HoldTimeoutDetector,
    StandstillDetector,
)
from swarm.flight.detect.station import StationDetector
from swarm.flight.detect.tracking import TrackingDetector
from swarm.flight.failures import FailureKind, Finding
from swarm.flight.observation import Expected, Observation
from swarm.flight.setup import Setup
from swarm.flight.stages import Stage

IN_FLIGHT = frozenset({Stage.EXECUTE, Stage.CONTINGENCY})
ON_PLAN = frozenset({Stage.EXECUTE})
OFF_PLAN = frozenset({Stage.CONTINGENCY})


class Detector(Protocol):
    """Compares an observation with the commanded state; has its own memory."""

    def detect(self, seen: Observation, expected: Expected) -> list[Finding]:
        """Return the failures and recoveries of this tick."""
        ...


@dataclass(frozen=True)
class Detectors:
    """All detectors of a flight."""

    station: StationDetector
    reports: ReportDetector
    links: LinkDetector
    motion: MotionDetector
    health: HealthDetector
    heights: HeightDetector
    grip_slip: GripSlipDetector
    tracking: TrackingDetector
    hold_timeout: HoldTimeoutDetector
    standstill: StandstillDetector
    blocked: BlockedDetector

    @classmethod
    def of(cls, setup: Setup) -> "Detectors":
        """Return the detectors of a flight that has not begun."""
        plan, fleet, options = setup.plan, setup.fleet, setup.options
        reported, n = Latch(), plan.vehicles
        carried = setup.carries_cable and not options.open_loop
        paced = not options.open_loop and options.error_limit is None
        return cls(
            station=StationDetector(),
            reports=ReportDetector(),
            links=LinkDetector(fleet.limits, reported),
            motion=MotionDetector(n, reported, cable=setup.carries_cable),
            health=HealthDetector(reported, gps=fleet.frame == "gps"),
            heights=HeightDetector(n, reported),
            grip_slip=GripSlipDetector(plan, reported, enabled=carried),
            tracking=TrackingDetector(options.error_limit, plan.mission.clearance.vehicle),
            hold_timeout=HoldTimeoutDetector(fleet.limits.hold),
            standstill=StandstillDetector(enabled=paced),
            blocked=BlockedDetector(),
        )

    def follow_frame(self, k: int, jump: Floats, kind: FailureKind) -> None:
        """Compare in a frame that moved by (3,) metres: with its position, or by a drift."""
        self.motion.follow_frame(k, jump)
        self.heights.follow_frame(k, jump, kind)

    def each_tick(self) -> Iterator[tuple[frozenset[Stage], Detector]]:
        """Yield the detectors in their order, each with the stages in which it detects."""
        yield IN_FLIGHT, self.links
        yield IN_FLIGHT, self.motion
        yield IN_FLIGHT, self.health
        yield IN_FLIGHT, self.heights
        yield ON_PLAN, self.station
        yield ON_PLAN, self.grip_slip
        yield ON_PLAN, self.tracking
        yield ON_PLAN, self.hold_timeout
        yield ON_PLAN, self.standstill
        yield OFF_PLAN, self.blocked
