"""The result of all checks of a plan, as a frozen value."""

from dataclasses import dataclass, field
from decimal import ROUND_FLOOR, Decimal
from typing import Literal

from swarm.certification.budget import Budget
from swarm.certification.clearances import CLEARANCES, Moment
from swarm.certification.findings import Finding
from swarm.certification.stream_loss import StreamLossCertificate
from swarm.certification.swing_tube import SwingTube

TIGHTEST = 5
"""Number of tightest moments in every report."""


@dataclass(frozen=True)
class Tightest:
    """The tightest moment of one kind of clearance.

    ``distance`` is the certified lower bound in metres, for every displacement within the tracking
    radius; ``between`` names the two objects ("segment 3", "vehicle 5").
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


def rounded_down(value: float, decimals: int) -> float:
    """Return a value up to which something holds as it is shown: never more than it holds for."""
    step = Decimal(1).scaleb(-decimals)
    return float(Decimal(repr(float(value))).quantize(step, ROUND_FLOOR))


@dataclass(frozen=True)
class Window:
    """Availability of a contingency while the cable is aloft.

    ``share`` of the time at which it is open; ``wait`` the largest time in seconds to the nearest
    open moment, forward or backward, infinite without an open moment.
    """

    share: float
    wait: float


@dataclass(frozen=True)
class Contingencies:
    """Windows to land together and to release; the longest stop in seconds and in metres."""

    land: Window
    release: Window
    stop_time: float
    stop_distance: float


@dataclass(frozen=True)
class Assessment:
    """Results of all checks of a plan.

    ``moments`` are the tightest of each kind of clearance. ``budget`` lists what reduces the
    distances of the tightest strands. ``contingencies`` is None where the cable is never aloft.
    ``stream_loss`` limits the clock's rate, so that clearances hold after a loss of setpoints.
    ``tube`` bounds the swing of the cable; None without a fold. ``swing_certified`` says whether
    clearances hold in it, for the planned motion and one ordinary stop with the resume that
    follows.
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
    contingencies: Contingencies | None = None
    stream_loss: StreamLossCertificate | None = None
    tube: SwingTube | None = None
    swing_certified: bool = False

    @property
    def tightest(self) -> tuple[Moment, ...]:
        """The TIGHTEST moments of all clearances, tightest first."""
        distances = [moment for moment in self.moments if moment.check in CLEARANCES]
        return tuple(sorted(distances, key=lambda moment: moment.margin)[:TIGHTEST])

    @property
    def cleared(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)
