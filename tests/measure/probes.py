"""What the families of generic shapes see at the model that the selection ends with, in campaigns of the hidden-effects study.

    python tests/measure/probes.py SEED KIND:NUMBER [KIND:NUMBER ...]

Prints for each campaign its hidden effects, the effects that are added, p over all probes as one of five tests, and the strongest
families with chi2 / degrees of freedom.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).parents[2]))

import numpy as np  # noqa: E402

from pipeline.criticism.fit_tests import Rules  # noqa: E402
from pipeline.criticism.problem import Problem  # noqa: E402
from pipeline.criticism.scores import baseline, cells_of, delta_chi2s, project  # noqa: E402
from pipeline.criticism.significance import log_any, log_tail  # noqa: E402
from pipeline.learning.campaign.answers import campaign_answers  # noqa: E402
from pipeline.learning.campaign.problem import CampaignProblem  # noqa: E402
from workflows.studies.hidden.draw import hide  # noqa: E402
from workflows.studies.hidden.restricted import RestrictedProblem  # noqa: E402

TESTS = 5


def measure(kind: str, number: int, seed: int) -> str:
    """One line about one campaign."""
    hidden = hide(kind, number, seed)

    def restricted(problem: CampaignProblem) -> Problem:
        return RestrictedProblem(problem, hidden.left_out) if hidden.left_out else problem

    answers, selection = campaign_answers(hidden.campaign, hidden.model, threads=1).selected(Rules(), restricted)
    fit = selection.last.fit
    shapes = answers.problem.probes(fit)
    projected, found = project(baseline(fit), shapes.blocks), []
    for family in shapes.candidates:
        cell = cells_of(projected, family)[0]
        if cell.rank:
            chi2 = float(delta_chi2s(cell, projected.score[:, None])[0][0]) / cell.inflation
            found.append((float(log_tail(chi2, cell.rank)), f"{family.name} {chi2:.0f} / {cell.rank}"))
    found.sort()
    p = float(np.exp(log_any(log_any(found[0][0], len(found)), TESTS)))
    best = ", ".join(what for _, what in found[:3])
    return f"{kind} {number}: {hidden.effects} -> {selection.added}; p = {p:.2g}; {best}"


if __name__ == "__main__":
    for item in sys.argv[2:]:
        name, _, place = item.partition(":")
        print(measure(name, int(place), int(sys.argv[1])), flush=True)
