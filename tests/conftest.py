"""One BLAS thread for all tests, set before numpy is loaded: the matrices are small and the cores are few."""

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# A shell that starts the suite in the background has it ignore Ctrl-C, as would all programs that the tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time, and no deadline: a busy machine is not a failure.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")

# The first two files, one for each worker, share no compiled kernels: with an empty cache both workers would compile them.
_LONGEST_FIRST = (
    "workflows/screening/test_batch.py",
    "workflows/test_modal_learning.py",
    "workflows/test_silverbox.py",
    "workflows/screening",
    "workflows",
    "pipeline/learning",
    "reports",
    "pipeline/identification",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first: two workers that take whole files then finish within seconds of each other."""
    root = Path(__file__).parent

    def place(item: pytest.Item) -> int:
        folder = item.path.relative_to(root).as_posix()
        return next((i for i, name in enumerate(_LONGEST_FIRST) if folder.startswith(name)), len(_LONGEST_FIRST))

    items.sort(key=place)


def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """The standard campaign, of ``simulate`` and of the study, with records of 1 s."""
    from workflows import simulate
    from workflows.studies.hidden import draw

    records = [(name, role, replace(e, duration_s=1.0)) for name, role, e in simulate.standard_excitations(1)]
    for module in (simulate, draw):
        monkeypatch.setattr(module, "standard_excitations", lambda seed: records)


@pytest.fixture
def brief_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """The standard campaign with records of 1 s: a third of the time for the same SNR."""
    brief(monkeypatch)


@pytest.fixture(scope="module")
def brief_records_of_module() -> Iterator[None]:
    """The same for the fixtures of a module."""
    with pytest.MonkeyPatch.context() as patch:
        brief(patch)
        yield


@pytest.fixture
def short_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """The standard campaign without its last record, and with records of 0.1 s."""
    from workflows.simulate import standard_excitations
    from workflows.studies.hidden import draw

    short = [(name, role, replace(e, duration_s=0.1)) for name, role, e in standard_excitations(1)[:-1]]
    monkeypatch.setattr(draw, "standard_excitations", lambda seed: short)
