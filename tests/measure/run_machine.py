"""The state machine of tests/workflows/run_machine.py with more and longer nights.

usage: python -m tests.measure.run_machine EXAMPLES [STEPS]; hypothesis keeps what failed, and tries it first the next time.
"""

from __future__ import annotations

import sys

from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.workflows.run_machine import Night


def main() -> None:
    """Run ``EXAMPLES`` nights of up to ``STEPS`` steps."""
    examples, steps = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 12
    run_state_machine_as_test(
        Night,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            print_blob=True,
        ),
    )
    print(f"{examples} nights of up to {steps} steps: as the reference")


if __name__ == "__main__":
    main()
