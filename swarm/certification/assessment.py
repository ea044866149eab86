"""The result of all checks of a plan, as a frozen value."""

from dataclasses import dataclass, field
from typing import Literal

from swarm.certification.budget import Budget
from swarm.certification.clearances import CLEARANCES, Moment
from swarm.certification.findings import Finding
from swarm.certification.stream_loss import CoastCertificate

TIGHTEST = 5
"""Number of tightest moments in every report."""


@dataclass(frozen=True)
class Tightest:
    """The tightest moment of one kind of clearance: what, when, how much, how much was asked.

    ``distance`` is the certified lower bound in metres, for every displacement in the tracking
    ball; ``between`` names the two things ("segment 3", "vehicle 5").
    """

    distance: float
    required: float
    time: float
    between: tuple[str, str]


@dataclass(frozen=True)
class Robustness:
    """e* (largest tracking error, m) and w* (largest steady wind, m/s); None where unknown."""

    tracking: float | None = None
    wind: float | None = None


@dataclass(frozen=True)
class Window:
    """A way out of the plan while the cable is aloft: share of the time at which it is open.

    ``wait`` is the largest time in seconds to the nearest open moment, forward or back; infinite
    where there is none.
    """

    share: float
    wait: float


@dataclass(frozen=True)
class Stops:
    """What if it stops here: windows to land together and to let go, and the longest stop."""

    land: Window
    release: Window
    time: float
    distance: float


@dataclass(frozen=True)
class Assessment:
    """Everything that the pre-flight checks found out about a plan.

    ``moments`` are the tightest of each kind of clearance, ``budget`` says what may eat the
    distances of the tightest strands; ``stops`` is None where the cable is never aloft. ``coast``
    caps the clock for the ends of setpoints.
    """

    findings: tuple[Finding, ...]
    cable: Tightest
    vehicle: Tightest
    vehicle_cable: Tightest
    knot: str
    chirality: Literal["left", "right", "none"]
    gauss: str
    robustness: Robustness = field(default_factory=Robustness)
    moments: tuple[Moment, ...] = ()
    budget: tuple[Budget, ...] = ()
    stops: Stops | None = None
    coast: CoastCertificate | None = None

    @property
    def tightest(self) -> tuple[Moment, ...]:
        """The five tightest moments of all clearances, tightest first."""
        apart = [moment for moment in self.moments if moment.check in CLEARANCES]
        return tuple(sorted(apart, key=lambda moment: moment.margin)[:TIGHTEST])

    @property
    def cleared(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)
