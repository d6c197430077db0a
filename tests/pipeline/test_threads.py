"""Work in threads gives the same results as a loop; a cached function is called once per argument."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from pipeline.threads import mapped, once


def test_results_have_the_order_of_the_items_and_the_first_failure_is_raised() -> None:
    def slow_first(item: int) -> int:
        time.sleep(0.02 if item == 0 else 0.0)
        return item * item

    assert mapped(slow_first, range(5), 3) == [0, 1, 4, 9, 16]

    def fails(item: int) -> int:
        raise ValueError(item)

    with pytest.raises(ValueError, match="0"):
        mapped(fails, range(5), 3)


def test_a_result_that_several_threads_request_at_once_is_computed_once() -> None:
    computed = []

    @once
    def make(size: int) -> object:
        computed.append(size)
        time.sleep(0.02)
        return object()

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(make, [3] * 4))
    assert computed == [3]
    assert all(each is found[0] for each in found)
