"""Many simulated flights of a plan, each under conditions of its own."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from swarm import planning
from swarm.certification.certificate import Certificate
from swarm.certification.kinds import required_distances
from swarm.errors import InputError, Interrupted, Problem, SwarmError
from swarm.files import read_text
from swarm.flight.flight_plan import FlightPlan
from swarm.front.flights import flyable
from swarm.mission.validation import LARGEST_FILE
from swarm.notebook import table
from swarm.simulation.loop import Fault
from swarm.simulation.spread import Spread, read_scenario
from swarm.simulation.summaries import CertifiedClearances, certify_clearances, summary
from swarm.simulation.trials import Trial, fly_trials, results_table, write_results
from swarm.simulation.workers import process_count

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[str, float], None]


@dataclass(frozen=True, repr=False, eq=False)
class Trials(Sequence[Trial]):
    """The trials of one plan, in the order of their numbers; see :func:`swarm.monte_carlo`.

    A sequence of :class:`swarm.Trial`. ``seed`` and ``spread`` determine the conditions: the same
    seed, number and spread give the same trial again.
    """

    plan: planning.Plan
    trials: tuple[Trial, ...]
    seed: int
    spread: Spread
    jobs: int | None = field(default=None)

    @overload
    def __getitem__(self, index: int) -> Trial: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Trial, ...]: ...

    def __getitem__(self, index: int | slice) -> Trial | tuple[Trial, ...]:
        return self.trials[index]

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[Trial]:
        return iter(self.trials)

    def to_arrow(self) -> Any:
        """Return a :class:`pyarrow.Table` with one row per trial.

        Columns are ``method``, ``seed`` and the fields of :class:`swarm.Trial` (metres, seconds,
        m/s). Source: :func:`swarm.simulation.trials.results_table`.
        """
        return results_table([(self.plan, self.trials)], self.seed, self.spread)

    def to_pandas(self) -> Any:
        """Return the table of :meth:`to_arrow` as a :class:`pandas.DataFrame`.

        Raises :class:`swarm.SwarmError` if pandas, which this package does not require, is not
        installed. Source: :func:`swarm.simulation.trials.results_table`.
        """
        try:
            import pandas  # noqa: F401, PLC0415 - optional
        except ImportError:
            message = "to_pandas() needs pandas: pip install pandas (to_arrow() does not need it)"
            raise SwarmError(message) from None
        return self.to_arrow().to_pandas()

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Write the table of :meth:`to_arrow` as a Parquet file.

        Raises :class:`swarm.InputError` where it cannot be written.
        Source: :func:`swarm.simulation.trials.write_results`.
        """
        write_results(Path(path), [(self.plan, self.trials)], self.seed, self.spread)

    @cached_property
    def certified(self) -> CertifiedClearances:
        """The certified distances for the tracking errors of the trials; computed once, in seconds.

        Source: :func:`swarm.simulation.summaries.certify_clearances`.
        """
        return certify_clearances(self.plan, self.trials, process_count(self.jobs))

    @property
    def required(self) -> Mapping[str, float]:
        """The clearances of the mission in metres, by name."""
        return required_distances(self.plan.mission)

    def summary(self) -> Mapping[str, Any]:
        """Return shares and distributions with 95 % intervals, and the worst trials.

        Distances in metres. ``["certificate"]["below"]`` lists the trials with a smaller distance
        than certified for their tracking error.
        Source: :func:`swarm.simulation.summaries.summary`.
        """
        return summary(
            self.plan, self.trials, seed=self.seed, spread=self.spread, certified=self.certified
        )

    def plot(self) -> "Figure":
        """Return a matplotlib figure: distributions of distances, flown beside certified distances.

        Source: :func:`swarm.reports.study_plots.trials_figure`.
        """
        from swarm.reports.study_plots import trial_distances, trials_figure  # noqa: PLC0415 - slow

        distances = trial_distances(self.plan, self.trials, self.certified)
        return trials_figure([distances], self.required)

    def __repr__(self) -> str:
        return f"<Trials {self.plan.mission.name}: {', '.join(self._figures().values())}>"

    def _repr_html_(self) -> str:
        return table(f"Trials {self.plan.mission.name}", self._figures().items())

    def _figures(self) -> dict[str, str]:
        """Return the key figures of the trials by name."""
        sound = [trial for trial in self.trials if not trial.failure]
        failing = [trial for trial in self.trials if trial.failure]
        figures = {"trials": f"{len(self.trials)} flown"}
        for name, group in (("no vehicle failing", sound), ("a vehicle failing", failing)):
            if group:
                done = sum(trial.completed for trial in group)
                figures[name] = f"{done} of {len(group)} completed with {name}"
        return figures


def monte_carlo(
    plan: planning.Plan,
    certificate: Certificate,
    *,
    trials: int = 200,
    seed: int = 1,
    jobs: int | None = None,
    scheduler: str | None = None,
    spread: Spread | None = None,
    faults: Sequence[Fault] = (),
    progress: Progress | None = None,
) -> Trials:
    """Simulate a plan many times, each time with other wind, links, masses and failures.

    ``trials`` is the number of trials, which are numbered from 0. ``spread`` has the distributions
    of the conditions (:class:`swarm.Spread`); ``faults`` (as for :func:`simulate`) happen in every
    trial. ``jobs`` processes of this machine share the work (None: one per core), or the workers of
    the Dask cluster at ``scheduler`` (tcp://host:port). ``seed`` and number determine a trial,
    for any number of processes. ``progress(stage, share)`` is called after each trial.

    Raises :class:`swarm.Refused` where the certificate belongs to another plan or has errors,
    :class:`swarm.InputError` for numbers out of range, and :class:`swarm.SwarmError` where the
    cluster's packages are missing or the scheduler does not respond.

    Source: :func:`swarm.simulation.trials.fly_trials`.
    """
    problems = [
        Problem(name, f"expected a whole number >= 1, got {value!r}")
        for name, value in (("trials", trials), ("jobs", 1 if jobs is None else jobs))
        if value < 1
    ]
    if problems:
        raise InputError(problems)
    flown, ended = fly_series(
        flyable(plan, certificate),
        spread or Spread(),
        trials=trials,
        seed=seed,
        faults=faults,
        jobs=jobs,
        scheduler=scheduler,
        on_trial=lambda done: progress("trials", done / trials) if progress else None,
    )
    if isinstance(ended, Interrupted):
        raise KeyboardInterrupt
    if ended:
        raise ended
    return flown


def load_scenario(path: str | os.PathLike[str] | None) -> tuple[Spread, tuple[Fault, ...]]:
    """Read a scenario file (YAML) and return the distributions, and the faults of every trial.

    Without a file: the default distributions and no faults.

    Raises :class:`swarm.InputError` with every problem at once.

    Source: :func:`swarm.simulation.spread.read_scenario`; `swarm schema scenario` prints the
    format.
    """
    if path is None:
        return Spread(), ()
    return read_scenario(read_text(path, LARGEST_FILE), os.fspath(path))


def fly_series(
    flight_plan: FlightPlan,
    spread: Spread,
    *,
    trials: int,
    seed: int,
    faults: Sequence[Fault] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
    open_loop: bool = False,
    on_trial: Callable[[int], None],
) -> tuple[Trials, SwarmError | None]:
    """Fly trials until an interrupt or error; return the completed trials, and what ended them.

    ``open_loop`` trials never slow down. ``on_trial`` is called after each trial with the number of
    those that are completed.
    """
    flown: list[Trial] = []
    ended: SwarmError | None = None
    flying = fly_trials(
        flight_plan, spread, seed=seed, trials=range(trials), faults=faults, jobs=jobs,
        scheduler=scheduler, open_loop=open_loop,
    )  # fmt: skip
    try:
        for trial in flying:
            flown.append(trial)
            on_trial(len(flown))
    except KeyboardInterrupt:
        flying.close()
        ended = Interrupted("stopped")
    except SwarmError as error:
        ended = error
    flown.sort(key=lambda trial: trial.number)
    # after an interrupt or error the certificates are computed in this process
    return Trials(flight_plan.plan, tuple(flown), seed, spread, 1 if ended else jobs), ended
