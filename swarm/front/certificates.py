"""Certificates of plans and of external trajectories."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Self, overload

import numpy as np

from swarm import planning
from swarm.certification.certificate import Certificate
from swarm.certification.certificate import certify as certified
from swarm.certification.motion_file import (
    MotionFile,
    plan_of_motion,
    read_lengths,
    read_motion,
)
from swarm.errors import InputError, Problem
from swarm.files import read_text
from swarm.front.plans import Plan
from swarm.geometry.motion import Motion as Quintics
from swarm.geometry.motion import through_states
from swarm.mission import Cable as CableSection
from swarm.mission import Mission, mission_for_knot
from swarm.mission.validation import LARGEST_FILE, validate
from swarm.planning.ranges import length_problems

Progress = Callable[[str, float], None]

LARGEST_MOTION = 500_000_000
"""Bytes of a motion table; an hour of a hundred vehicles takes less."""


@dataclass(frozen=True)
class Cable:
    """The cable of an external trajectory.

    ``lengths`` (n − 1,) are the lengths of the segments in metres, in order along the cable.
    ``mass_per_length`` (kg/m), ``diameter`` (m), ``length_tolerance`` (m per segment) and
    ``breaking_load`` (N) are None for the values of the mission.

    Raises :class:`swarm.InputError` for values out of range. Source: :class:`swarm.mission.Cable`.
    """

    lengths: Sequence[float]
    mass_per_length: float | None = None
    diameter: float | None = None
    length_tolerance: float | None = None
    breaking_load: float | None = None

    def __post_init__(self) -> None:
        problems = length_problems(self.lengths, "cable")
        if not len(self.lengths):
            problems = [Problem("cable", "expected the lengths of segments, got none")]
        if problems:
            raise InputError(problems)
        self.section(CableSection())

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Self:
        """Read the lengths of the segments in metres from a JSON or CSV file.

        JSON: a list, or the JSON of a plan. CSV: one length per line, or a heading with the column
        length.
        Raises :class:`swarm.InputError` with each wrong length.

        Source: :func:`swarm.certification.motion_file.read_lengths`.
        """
        lengths = read_lengths(read_text(path, LARGEST_FILE), os.fspath(path))
        return cls(tuple(lengths.tolist()))

    def section(self, default: CableSection) -> CableSection:
        """Return the cable section of a mission; ``default`` has the values that are None."""
        given = {
            name: value
            for name in ("mass_per_length", "diameter", "length_tolerance", "breaking_load")
            if (value := getattr(self, name)) is not None
        }
        return validate(CableSection, {**default.model_dump(), **given}, "cable")


@dataclass(frozen=True, repr=False)
class Motion(Quintics):
    """An external trajectory: the motion of n grip points with its phases.

    ``motion(t)`` returns position, velocity and acceleration, each (…, n, 3), ENU and SI, at times
    (…,) in seconds: the quintic through the rows of the table. ``table`` has these rows: ``time``
    (k,), ``states`` (k, n, 9) and ``phase`` (k,). Create it with :meth:`from_csv`.

    Source: :class:`swarm.geometry.motion.Motion`.
    """

    table: MotionFile = field(kw_only=True)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> Self:
        """Read a table of the motion, as :meth:`swarm.Plan.to_csv` writes it.

        Columns: time, vehicle (1…n along the cable), x, y, z, vx, vy, vz, ax, ay, az (ENU, m, m/s,
        m/s²), phase. Raises :class:`swarm.InputError` with each wrong line.

        Source: :func:`swarm.certification.motion_file.read_motion`.
        """
        rows = read_motion(read_text(path, LARGEST_MOTION), os.fspath(path))
        motion = through_states(rows.time, *np.split(rows.states, 3, axis=-1))
        return cls(motion.times, motion.coefficients, table=rows)

    def plan(self, cable: Cable, mission: Mission | None = None) -> Plan:
        """Return the motion with its cable as a plan, as :func:`certify` checks it.

        ``mission`` has vehicles, clearances, wind and workspace, by default the values of
        :meth:`swarm.Mission.for_knot`, with a negative clearance budget accepted; its knot has no
        effect.
        Raises :class:`swarm.InputError` unless there is one length fewer than vehicles, and where
        no row has the cable aloft.

        Source: :func:`swarm.certification.motion_file.plan_of_motion`.
        """
        limits = mission or mission_for_knot("overhand", ["limits.accept_negative_budget=true"])
        limits = limits.model_copy(update={"cable": cable.section(limits.cable)})
        lengths = np.array(cable.lengths, dtype=np.float64)
        return Plan.of(plan_of_motion(self.table, lengths, limits))


@overload
def certify(
    motion: planning.Plan, *, robustness: bool = True, progress: Progress | None = None
) -> Certificate: ...


@overload
def certify(
    motion: Motion,
    *,
    cable: Cable,
    mission: Mission | None = None,
    robustness: bool = True,
    progress: Progress | None = None,
) -> Certificate: ...


def certify(
    motion: planning.Plan | Motion,
    *,
    cable: Cable | None = None,
    mission: Mission | None = None,
    robustness: bool = True,
    progress: Progress | None = None,
) -> Certificate:
    """Return the certificate of a plan or of an external trajectory, cleared or not.

    A :class:`swarm.Motion` needs its ``cable``, and has its limits from ``mission`` (see
    :meth:`swarm.Motion.plan`); a plan has both. The certificate belongs to exactly this plan, by
    digest. With ``robustness`` it includes e* (``max_tracking_error``, m) and w* (``max_wind``,
    m/s), which takes about three times as long as the rest: seconds for an overhand knot, a minute
    for large ones. ``progress(stage, share)`` is called with the name of a stage and its completed
    share, 0…1.

    A cleared certificate holds for every clearance in the quasi-static cable model, and for every
    displacement of every grip point by up to ``mission.vehicles.tracking``; with ``fold.swing`` in
    metres also around it, as far as the cable swings in the planned motion and after one ordinary
    stop with the resume that follows.

    Raises :class:`swarm.InputError` where a cable is missing, is given with a plan or does not fit.

    Source: :mod:`swarm.certification.certificate`; interval bounds and bisection in
    :mod:`swarm.certification.clearances`.
    """
    if isinstance(motion, Motion):
        if cable is None:
            raise InputError([Problem("cable", "expected swarm.Cable(lengths=…), got none")])
        return certified(motion.plan(cable, mission), robustness=robustness, progress=progress)
    given = [name for name, value in (("cable", cable), ("mission", mission)) if value is not None]
    if given:
        raise InputError([Problem(name, "expected none: a plan has its own") for name in given])
    return certified(motion, robustness=robustness, progress=progress)
