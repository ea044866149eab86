"""Renew or check the goldens: ``python -m tests.golden renew|check [NAMES]``.

NAMES are whole names (``plans/3_1``), folders (``failures``) or patterns (``plans/8_*``).
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from joblib import Parallel, cpu_count, delayed

from tests.golden.cases import CASES, Case, chosen, left_over

_AT_ONCE = 14
"""Failures that one process flies one after another: the flight up to there is flown once."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 1 where something is not as it is kept."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("what", choices=("renew", "check", "list"))
    parser.add_argument("names", nargs="*", metavar="NAMES")
    parser.add_argument("--jobs", type=int, default=cpu_count(), help="processes (all cores)")
    given = parser.parse_intermixed_args(arguments)
    try:
        cases = chosen(given.names)
    except ValueError as error:
        parser.error(str(error))
    if given.what == "list":
        print("\n".join(case.name for case in cases))
        return 0
    return _run(cases, renew=given.what == "renew", jobs=given.jobs, everything=not given.names)


def _run(cases: Sequence[Case], *, renew: bool, jobs: int, everything: bool) -> int:
    began = time.monotonic()
    names = [[case.name for case in portion] for portion in _portions(cases)]
    changed = 0
    running = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(_work)(portion, renew=renew) for portion in names
    )
    finished = (one for portion in running for one in portion)
    for done, (name, how, words, seconds) in enumerate(finished, 1):
        changed += bool(words)
        state = ("renewed" if renew else "DIFFERS") if words else how
        print(f"[{done:3}/{len(cases)}] {name:<44} {seconds:6.1f} s  {state}", flush=True)
        for line in words:
            print(f"            {line}", flush=True)
    for path in left_over() if everything else ():
        changed += 1
        print(f"{_shown(path)}: no case has this name{'; removed' if renew else ''}")
        if renew:
            path.unlink()
    verb = "renewed with differences" if renew else "not as kept"
    print(f"{changed} of {len(cases)} {verb}, {time.monotonic() - began:.0f} s")
    return 0 if renew or not changed else 1


def _portions(cases: Sequence[Case]) -> list[list[Case]]:
    """Share the work out, longest first."""
    failures = [case for case in cases if case.name.startswith("failures/")]
    alone = [[case] for case in cases if case not in failures]
    together = [failures[k : k + _AT_ONCE] for k in range(0, len(failures), _AT_ONCE)]
    return sorted([*alone, *together], key=lambda cs: -sum(case.cost for case in cs))


def _work(names: Sequence[str], *, renew: bool) -> list[tuple[str, str, list[str], float]]:
    """Renew or check some cases in a process of its own; each is kept as soon as it is made.

    Of each its name, how it agrees where it does, what differs, and the seconds that it took.
    """
    cases = {case.name: case for case in CASES}
    found = []
    for name in names:
        began = time.monotonic()
        case = cases[name]
        how = "as kept" if case.exact else "as kept, within tolerances"
        words = _renewed(case) if renew else case.check()
        found.append((name, how, words, time.monotonic() - began))
    return found


def _renewed(case: Case) -> list[str]:
    before, text = case.kept(), case.make()
    case.keep(text)
    if before is None:
        return ["new"]
    if before == text:
        return []
    return case.differences(before, text) or ["the environment alone: every figure is the same"]


def _shown(path: Path) -> str:
    return path.relative_to(Path(__file__).parent).as_posix()


if __name__ == "__main__":
    sys.exit(main())
