"""Computations side by side: the results, their order, errors, and how far they run ahead."""

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
