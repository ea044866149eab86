"""Computations side by side: the results, their order, errors, and how far they run ahead."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.threads import side_by_side


@given(items=st.lists(st.integers(), max_size=20), threads=st.integers(1, 5))
def test_results_keep_the_order_of_their_items(items: list[int], threads: int) -> None:
    assert list(side_by_side(lambda item: 3 * item, items, threads=threads)) == [
        3 * item for item in items
    ]


def test_computations_run_at_the_same_time() -> None:
    met = threading.Barrier(3)
    assert len(list(side_by_side(lambda _: met.wait(timeout=60.0), range(3), threads=3))) == 3


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_reaches_the_caller_and_ends_the_others(threads: int) -> None:
    begun: list[int] = []

    def reciprocal(item: int) -> float:
        begun.append(item)
        return 1.0 / item

    with pytest.raises(ZeroDivisionError):
        list(side_by_side(reciprocal, range(1000, -1000, -1), threads=threads))
    assert len(begun) <= 1001 + 2 * 3 + 1


def test_items_are_not_taken_long_before_their_results() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for item in range(100):
            taken.append(item)
            yield item

    results = side_by_side(lambda item: item, items(), threads=2)
    assert next(results) == 0
    assert len(taken) == 5
    results.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes are forked here")
def test_a_forked_process_has_threads_of_its_own() -> None:
    program = (
        "import os\nfrom swarm.threads import side_by_side\n"
        "double = lambda: list(side_by_side(lambda x: 2 * x, [1, 2], threads=2))\n"
        "assert double() == [2, 4]\n"
        "child = os.fork()\n"
        "if child == 0:\n    os._exit(0 if double() == [2, 4] else 1)\n"
        "raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], timeout=60.0, check=False
    )
    assert done.returncode == 0


def test_work_side_by_side_may_be_made_of_such_work() -> None:
    def rows(deep: int) -> list[int]:
        return [sum(rows(deep - 1)) if deep else 1 for _ in side_by_side(abs, [1, 2], threads=2)]

    assert list(side_by_side(rows, [3, 3, 3, 3], threads=2)) == [[8, 8]] * 4
