"""The fixture of the benchmarks, and the option of its time."""

from __future__ import annotations

from typing import Any

import pytest
from bench.timing import SECONDS, Timed
from threadpoolctl import threadpool_limits


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--bench-seconds``: see :class:`bench.timing.Timed`."""
    parser.addoption("--bench-seconds", type=float, default=SECONDS, help="processor time for a benchmark [s]")


@pytest.fixture
def timed(benchmark: Any, request: pytest.FixtureRequest) -> Any:
    """See :class:`bench.timing.Timed`; one BLAS thread, as in a block."""
    with threadpool_limits(limits=1):
        yield Timed(benchmark, request.config.getoption("--bench-seconds"))
