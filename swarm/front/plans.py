"""Plans with files, figures and views."""

import os
from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt

from swarm import planner, planning, precompile
from swarm.certification.certificate import Certificate, CertifiedPlan, require_no_errors
from swarm.errors import Refused
from swarm.exports import MOTION_STEP, motion_rows
from swarm.files import read_bytes, write_bytes
from swarm.front.plan_files import LARGEST_PLAN, certified_plan_file
from swarm.front.recordings import Recording
from swarm.mission import Mission
from swarm.mission.fleet import Fleet, mission_for
from swarm.notebook import table
from swarm.planning.archive import plan_file, read_plan_file
from swarm.planning.cable_shape import cable_shape
from swarm.planning.estimates import require_fleet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, float], None]
Picture = Literal["knot", "schedule"]


class NotCleared(Refused):
    """The mission has a plan, but the checks do not clear it.

    ``plan`` and ``certificate`` show the reasons. The message has one line per error.
    """

    def __init__(self, message: str, plan: "Plan", certificate: Certificate) -> None:
        self.plan, self.certificate = plan, certificate
        super().__init__(message)


class Plan(planning.Plan):
    """A complete flight: the motion of n grip points, phases, gates, knot and layout.

    Returned by :func:`swarm.plan` and :func:`swarm.load_plan`. Immutable: change the mission and
    plan again. Lengths are in metres, times in seconds of mission time (0 at take-off), positions
    in ENU (x east, y north, z up). The centre of a vehicle is ``mission.vehicles.grip_offset``
    above its grip point.

    ``motion(t)`` returns position, velocity and acceleration, each (…, n, 3), at times (…,);
    ``duration``, ``vehicles``, ``phase(name)``, ``layout.lengths`` (n − 1,) and ``knot`` have the
    rest. Source: :class:`swarm.planning.Plan`.
    """

    @classmethod
    def of(cls, plan: planning.Plan) -> Self:
        """Return a plan of the planning layer with the methods of this class; arrays are shared."""
        return cls(**{field.name: getattr(plan, field.name) for field in fields(plan)})

    def cable_at(self, time: npt.ArrayLike, points: int = 100) -> Floats:
        """Return the cable at mission times (…,) in seconds: (…, n − 1, points, 3), ENU metres.

        Each of the n − 1 segments has ``points`` evenly spaced points, ends included: the catenary
        of its length in still air, on the floor (z = 0) where it touches it. NaN where the plan
        does not determine the cable: after a release aloft, or held by its ends alone.

        Raises :class:`swarm.InputError` for times that are not finite or fewer than 2 points, and
        :class:`swarm.SwarmError` where a chord is longer than its cable (in no cleared plan).

        Source: :func:`swarm.planning.cable_shape.cable_shape`; the catenary is Routh's, *Statics*.
        """
        return cable_shape(self, time, points)

    def save(self, path: str | os.PathLike[str], certificate: Certificate | None = None) -> None:
        """Write the plan as one file for :func:`swarm.load_plan`; an existing file is replaced.

        A ZIP archive of JSON and NumPy arrays with the plan's digest; equal plans give equal files.
        With its ``certificate``, `swarm fly` and the other commands take the file as a mission.
        Raises :class:`swarm.InputError` where the file cannot be written, and
        :class:`swarm.Refused` where the certificate belongs to another plan or has errors.

        Source: :mod:`swarm.planning.archive`, :mod:`swarm.front.plan_files`.
        """
        if certificate is None:
            write_bytes(path, plan_file(self))
        else:
            write_bytes(path, certified_plan_file(CertifiedPlan(self, certificate)))

    def to_csv(self, path: str | os.PathLike[str], step: float = MOTION_STEP) -> None:
        """Write the motion of every grip point as CSV, a row per vehicle every ``step`` seconds.

        Columns: time, vehicle (1…n along the cable), position, velocity and acceleration (ENU, m,
        m/s, m/s²), phase. :meth:`swarm.Motion.from_csv` reads it.
        Raises :class:`swarm.InputError` where the file cannot be written.

        Source: :func:`swarm.exports.motion_rows`.
        """
        write_bytes(path, ("\n".join(motion_rows(self, step)) + "\n").encode())

    def plot(self, picture: Picture = "knot") -> "Figure":
        """Return a matplotlib figure of the plan; ``figure.savefig(path)`` writes it.

        ``"knot"``: grid diagram, plan view and the folded cable in space. ``"schedule"``: progress
        of each vehicle along the path of the fold, and its height, over time.

        Raises :class:`ValueError` for another picture. Source: :mod:`swarm.reports.plots`.
        """
        from swarm.reports import plots  # noqa: PLC0415 - slow to import

        if picture not in {"knot", "schedule"}:
            raise ValueError(f"picture: expected knot or schedule, got {picture!r}")
        return plots.plan_figure(self) if picture == "knot" else plots.schedule_figure(self)

    def view(self, path: str | os.PathLike[str] | None = None) -> Recording:
        """Write the plan as a Rerun recording and open it in Rerun's viewer, a separate process.

        The recording is written to ``path`` (.rrd), otherwise to a temporary file that is deleted
        when Python ends. Without a display, a :class:`UserWarning` replaces the viewer.
        Raises :class:`swarm.InputError` where the file cannot be written.

        Source: :mod:`swarm.view.replay`.
        """
        from swarm.view.replay import write_plan  # noqa: PLC0415 - slow to import

        return Recording.written(lambda file: write_plan(self, file), path)

    def _repr_html_(self) -> str:
        return table(f"Plan {self.mission.name}", self.figures().items())


def plan(mission: Mission, *, fleet: Fleet | None = None, progress: Progress | None = None) -> Plan:
    """Plan a mission and return the first plan that the checks clear.

    With a ``fleet`` that was measured (``tracking`` in metres, by ``swarm check --hop``) the plan
    is certified for that tracking error, where the mission's own is smaller.
    ``progress(stage, share)`` is called with the name of a stage and its completed share, 0…1. The
    same mission gives the same plan.

    Raises :class:`swarm.Refused` with every reason where no motion exists, or the fleet is too
    small; :class:`swarm.NotCleared`, with a plan and its certificate, where no plan is cleared; and
    :class:`swarm.InputError` for a knot that does not exist.

    Source: :func:`swarm.planner.plan`, which certifies and repairs the candidates of
    :mod:`swarm.planning.candidates` (grid diagram, layout, folding).
    """
    if fleet is not None:
        require_fleet(mission, fleet)
        mission = mission_for(mission, fleet)
    precompile.prepare(precompile.PLANNING, progress)
    precompile.prepare(planner.compiled_for(mission), progress)
    result = planner.plan(mission, progress, robustness=False)
    planned = Plan.of(result.plan)
    try:
        require_no_errors(result.certificate)
    except Refused as refusal:
        raise NotCleared(str(refusal), planned, result.certificate) from None
    return planned


def load_plan(path: str | os.PathLike[str]) -> Plan:
    """Read a plan file of :meth:`Plan.save`; the plan is the same to the last bit.

    A certificate of the saved plan belongs to the returned plan too.
    Raises :class:`swarm.InputError` for a file that cannot be read, is no plan file, is incomplete
    or changed, or has another version of the format.

    Source: :mod:`swarm.planning.archive`.
    """
    name = os.fspath(path)
    return Plan.of(read_plan_file(read_bytes(path, LARGEST_PLAN), name).plan)
