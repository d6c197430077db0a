"""One dask worker for the runs of a test file: starting a worker and its imports cost more than most runs here."""

from collections.abc import Iterator

import dask
import pytest
from distributed import LocalCluster

from tests.stub_runs import empty_pages


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler with one worker process of one thread."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ": threads}),
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50) as local,
    ):
        yield local.scheduler_address


@pytest.fixture
def without_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """For runs whose tables are compared."""
    empty_pages(monkeypatch)
