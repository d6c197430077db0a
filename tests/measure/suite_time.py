"""Processor time of each test, its children included: where the time of the suite goes.

    PYTHONPATH=tests python -m pytest -n 0 -p measure.suite_time --times FILE [TESTS]     one line of JSON per test and phase
    python tests/measure/suite_time.py FILE..                                             sums by folder and file, longest tests

A child counts in the phase that waits for its end. ``compiling_s`` is the wall-clock part in which numba compiled.
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from numba.core import event


def processor_s() -> float:
    """Of this process and of its children that ended [s]."""
    return sum(os.times()[:4])


def outermost_s(marks: Iterable[tuple[float, event.Event]]) -> float:
    """Length of the events that lie in no other [s]: a kernel compiles those that it calls."""
    depth, since, total = 0, 0.0, 0.0
    for stamp, each in marks:
        since = stamp if depth == 0 else since
        depth += 1 if each.is_start else -1
        total += stamp - since if depth == 0 else 0.0
    return total


@contextmanager
def timed(path: Path, test: str, phase: str) -> Iterator[None]:
    """Appends one row to ``path``."""
    start = processor_s()
    with event.install_recorder("numba:compile") as recorder:
        yield
    row = {"test": test, "phase": phase, "s": processor_s() - start, "compiling_s": outermost_s(recorder.buffer)}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--times", required=True, type=lambda name: Path(name).absolute())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    with timed(item.config.getoption("--times"), item.nodeid, "setup"):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    with timed(item.config.getoption("--times"), item.nodeid, "call"):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    with timed(item.config.getoption("--times"), item.nodeid, "teardown"):
        return (yield)


def main(paths: list[Path]) -> None:
    """Prints sums [s of processor time, s of compiling]."""
    rows = [json.loads(line) for path in paths for line in path.read_text(encoding="utf-8").splitlines()]
    sums: dict[str, Counter[str]] = {kind: Counter() for kind in ("folder", "file", "test")}
    compiling: dict[str, Counter[str]] = {kind: Counter() for kind in sums}
    for row in rows:
        file = row["test"].split("::")[0]
        names = {"folder": str(Path(file).parent), "file": file, "test": f"{row['test']} [{row['phase']}]"}
        for kind, name in names.items():
            sums[kind][name] += row["s"]
            compiling[kind][name] += row["compiling_s"]
    print(f"{sum(row['s'] for row in rows):8.1f} s, compiling {sum(row['compiling_s'] for row in rows):.1f} s")
    for kind, count in (("folder", 100), ("file", 60), ("test", 120)):
        print(f"\nby {kind}")
        for name, seconds in sums[kind].most_common(count):
            print(f"{seconds:8.2f} {compiling[kind][name]:8.2f}  {name}")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
