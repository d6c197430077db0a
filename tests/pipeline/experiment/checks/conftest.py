import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from pipeline.experiment.record import Campaign

# Test files are imported one by one (importlib mode); planted_faults.py is shared by those of this folder.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """One BLAS thread: the matrices are small."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def sound() -> Campaign:
    """A campaign without faults."""
    from planted_faults import healthy

    return healthy()
