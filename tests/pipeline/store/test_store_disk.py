"""Every write may fail: in commit, journal, checkpoint, merge, amend and page; afterwards the run goes on and is the same.

All of them: ``python -m tests.measure.failed_writes FOLDER``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.disk import KINDS
from tests.measure.failed_writes import fault, operations, undisturbed

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="finds files by their descriptors")


def test_a_sample_of_failing_operations_leaves_a_run_that_can_be_resumed_and_is_the_same(tmp_path: Path) -> None:
    expected, count = undisturbed(tmp_path / "undisturbed"), operations(tmp_path / "counted")
    assert count > 80
    for number, moment in enumerate(range(3, count + 1, count // 5)):
        assert fault(tmp_path / str(number), KINDS[number % len(KINDS)], moment, expected) == ""
