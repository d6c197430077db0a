"""Wall-clock and processor time of the selection that `refine` makes, of campaigns of the hidden-effects study in turn.

    python tests/measure/selection_time.py SEED KIND FIRST COUNT

All cores work on one campaign, as for a user; the study itself gives one core to each.  Prints a line for each campaign, and the
median, the time below which nine in ten are, and the largest.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).parents[2]))

import numpy as np  # noqa: E402

from pipeline.criticism.fit_tests import Rules  # noqa: E402
from pipeline.criticism.ladder import as_ladder  # noqa: E402
from pipeline.criticism.problem import Problem  # noqa: E402
from pipeline.learning.campaign.answers import campaign_answers  # noqa: E402
from pipeline.learning.campaign.problem import CampaignProblem  # noqa: E402
from workflows.studies.hidden.draw import hide  # noqa: E402
from workflows.studies.hidden.restricted import RestrictedProblem  # noqa: E402

#: Goal for a standard campaign of unknown physics [s].
GOAL_S = 45.0


def measure(seed: int, kind: str, number: int) -> float:
    """Wall-clock time [s] from the records to the ladder."""
    hidden = hide(kind, number, seed)

    def restricted(problem: CampaignProblem) -> Problem:
        return RestrictedProblem(problem, hidden.left_out) if hidden.left_out else problem

    start, busy = time.perf_counter(), time.process_time()
    answers, selection = campaign_answers(hidden.campaign, hidden.model).selected(Rules(), restricted)
    ladder = as_ladder(restricted(answers.problem), selection)
    seconds, busy = time.perf_counter() - start, time.process_time() - busy
    effects = " + ".join(f"{name} {snr:.0f}" for name, snr in zip(hidden.effects, hidden.snr))
    added = ", ".join(ladder.terms) or "none"
    print(f"{kind} {number:3d}  {seconds:6.1f} s  {busy:6.1f} s busy  {effects}: {ladder.verdict}, {added}", flush=True)
    return seconds


if __name__ == "__main__":
    seed, first, count = (int(sys.argv[i]) for i in (1, 3, 4))
    times = np.array([measure(seed, sys.argv[2], number) for number in range(first, first + count)])
    within = int(np.sum(times <= GOAL_S))
    print(
        f"median {np.median(times):.1f}, nine in ten below {np.quantile(times, 0.9):.1f}, largest {times.max():.1f} s; "
        f"{within} of {times.size} within {GOAL_S:g} s"
    )
