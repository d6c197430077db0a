"""A night against a simple reference; more of it: ``python -m tests.measure.run_machine EXAMPLES``."""

from __future__ import annotations

import sys

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.workflows.run_machine import Night


@pytest.mark.skipif(sys.platform != "linux", reason="finds files by their descriptors")
def test_a_night_that_is_killed_resumed_changed_and_amended_is_what_a_dict_says() -> None:
    small = settings(
        max_examples=3,
        stateful_step_count=5,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(Night, settings=small)
