"""All goldens: what each one is called, how it is made, and how two of them are compared."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

from tests.golden import failures, flights, plans
from tests.golden.environment import environment, environment_of

FOLDER = Path(__file__).parent

_FIRST_STEPS = tuple(f"missions/first-steps/{name}" for name in ("hover", "two_carry", "pass_over"))
QUICK_PLANS = ("3_1", *_FIRST_STEPS)
"""Plans that the default test run makes anew."""
WITH_ROBUSTNESS = (*_FIRST_STEPS, "missions/overhand", "missions/figure_eight")
"""Plans whose e* and w* are kept too: each takes about twice as long as the rest of the plan."""
KNOTS = (
    "3_1", "m3_1", "4_1", "5_1", "5_2", "m5_2", "6_1", "6_2", "6_3", "7_1", "7_4", "7_7",
    "8_5", "8_9", "8_18", "8_19", "8_20", "granny", "square", "3_1#4_1", "torus(3,5)",
)  # fmt: skip
"""Knots of the default mission, three to ten crossings, sums and torus knots."""

Compare = Callable[[str, str], list[str]]


@dataclass(frozen=True)
class Case:
    """One golden.

    ``make`` returns its text as it is now. ``differences`` says in figures what a renewal changes;
    ``disagreements`` says where two differ by more than another CPU explains. Of a ``quick`` case
    the default test run makes it anew; ``cost`` is about how many seconds that takes.
    """

    name: str
    suffix: str
    make: Callable[[], str]
    differences: Compare
    disagreements: Compare
    quick: bool
    cost: float

    @property
    def path(self) -> Path:
        """Where it is kept."""
        return FOLDER / f"{self.name}{self.suffix}"

    def kept(self) -> str | None:
        """Return the text that is kept; None where there is none yet."""
        return self.path.read_text(encoding="utf-8") if self.path.exists() else None

    def keep(self, text: str) -> None:
        """Write a text in place of what is kept."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(text, encoding="utf-8", newline="\n")

    @property
    def exact(self) -> bool:
        """Whether the kept text was made in this environment, so that every bit must agree."""
        kept = self.kept()
        return kept is not None and environment_of(kept) == environment()

    def check(self) -> list[str]:
        """Make it anew; return where it is not what is kept."""
        kept = self.kept()
        if kept is None:
            return [f"{self.path.name} is missing: python -m tests.golden renew {self.name}"]
        return self.compared(kept, self.make())

    def compared(self, kept: str, text: str) -> list[str]:
        """Return where a text is not what is kept; both may be a part of the golden."""
        if not self.exact:
            return self.disagreements(kept, text)
        return (self.differences(kept, text) or ["the text"]) if text != kept else []


def _plan(name: str, source: str) -> Case:
    make = partial(plans.make, source, robustness=name in WITH_ROBUSTNESS)
    return Case(
        f"plans/{name}", ".json", make, plans.differences, plans.disagreements,
        name in QUICK_PLANS, _COSTS.get(name, 5.0),
    )  # fmt: skip


def _is_quick(row: str) -> bool:
    """Of the gaps in a link, the long ones of all vehicles, which the team must answer."""
    return "-gap-of-" not in row or row.endswith("-of-10-s-all")


_COSTS = {
    "8_9": 50.0, "8_18": 35.0, "7_7": 25.0, "8_5": 17.0, "7_4": 15.0, "7_1": 12.0, "torus(3,5)": 13.0,
    "missions/carrick_mat": 400.0, "missions/endless": 300.0, "missions/septafoil": 300.0,
    "missions/granny": 250.0, "missions/stevedore": 120.0, "missions/eight_nineteen": 120.0,
    "missions/square": 110.0, "missions/cinquefoil": 65.0,
}  # fmt: skip


def _cases() -> Sequence[Case]:
    files = sorted(plans.MISSIONS.rglob("*.yaml"))
    missions = [
        path.relative_to(plans.MISSIONS).as_posix()
        for path in files
        if not {"fleets", "scenarios"} & set(path.relative_to(plans.MISSIONS).parts)
    ]
    return (
        *(_plan(name, name) for name in KNOTS),
        *(_plan(f"missions/{name.removesuffix('.yaml')}", name) for name in missions),
        *(
            Case(f"flights/{name}", ".txt", partial(flights.make, name),
                 flights.differences, flights.disagreements, True, 3.0)
            for name in flights.FLIGHTS
        ),
        *(
            Case(f"failures/{name}", ".txt", partial(failures.make, name),
                 failures.differences, failures.disagreements, _is_quick(name), 0.5)
            for name in failures.NAMES
        ),
    )  # fmt: skip


CASES = _cases()


def chosen(names: Sequence[str]) -> list[Case]:
    """Return the cases of these names: a whole name, a folder, or a pattern with ``*``.

    Raises :class:`ValueError` with every name that fits none.
    """
    unknown = [name for name in names if not any(_fits(case, name) for case in CASES)]
    if unknown:
        raise ValueError(f"no such golden: {', '.join(unknown)}")
    return [case for case in CASES if not names or any(_fits(case, name) for name in names)]


def _fits(case: Case, name: str) -> bool:
    name = name.rstrip("/")
    return case.name == name or case.name.startswith(f"{name}/") or fnmatch(case.name, name)


def left_over() -> list[Path]:
    """Return files of goldens that no case keeps any more."""
    kept = {case.path for case in CASES}
    folders = {case.path.parent for case in CASES}
    return sorted(
        path
        for folder in folders
        for path in folder.glob("*")
        if path.is_file() and path not in kept
    )
