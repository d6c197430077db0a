"""The scan for an additional mode finds it; a mode within the resonance of a plant mode is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.criticism.selection import forward_selection
from pipeline.experiment.forward.record import forward
from pipeline.learning.campaign.answers import campaign_answers
from pipeline.learning.campaign.modes import mode_candidate
from workflows.studies.hidden.draw import hide
from workflows.studies.hidden.effects import LIBRARY
from workflows.studies.hidden.restricted import RestrictedProblem

NAME = "parasitic_mode"


@pytest.mark.usefixtures("brief_records")
@pytest.mark.parametrize("f_hz", [329.0, 617.3, 1773.0])
def test_the_scan_peaks_at_the_mode_with_a_decrease_of_chi2_near_its_squared_snr(f_hz: float) -> None:
    hidden = hide("none", 0, 2026)
    problem = campaign_answers(hidden.campaign, threads=1).problem
    problem.fit(())
    model = problem.model.with_effect(NAME)
    values = {**problem.campaign_fit(()).values, f"{NAME}.f": f_hz, f"{NAME}.zeta": 3e-3, f"{NAME}.a": 30.0}

    def added(size: float) -> list[np.ndarray]:
        sized = {**values, f"{NAME}.b_d1": size, f"{NAME}.b_d2": -0.5 * size}
        return [forward(model, sized, r, hidden.campaign.instrument) for r in hidden.campaign.records]

    without, once = added(0.0), added(1e-3)
    unit = np.sqrt(sum(float(np.sum(((b - a) / problem.noise.sigma_v) ** 2)) for a, b in zip(without, once)))
    change = [100.0 / unit * (b - a) for a, b in zip(without, once)]
    records = [replace(r, sense_v=r.sense_v + c) for r, c in zip(hidden.campaign.records, change)]
    with_mode = campaign_answers(replace(hidden.campaign, records=tuple(records)), threads=1).problem
    found = mode_candidate(
        NAME, (f"{NAME}.f", f"{NAME}.zeta"), with_mode.fit(()), with_mode.scans, 2, with_mode.noise.sigma_v
    )
    best = int(np.argmax(found.delta_chi2s))
    assert abs(found.grid[best][f"{NAME}.f"] / f_hz - 1.0) < 0.03
    # Held-out records and the part that the plant absorbs do not count; the nearest grid point is a little off the mode.
    assert 0.2 * 100.0**2 < found.delta_chi2s[best] < 100.0**2


@pytest.mark.usefixtures("brief_records")
def test_the_grid_is_fine_in_the_driven_band_and_coarse_elsewhere() -> None:
    problem = campaign_answers(hide("none", 0, 2026).campaign, threads=1).problem
    problem.fit(())
    points = [(p.f_hz, p.zeta) for p in problem.scans[0].points]
    assert min(f for f, _ in points) == 300.0
    assert max(f for f, _ in points) > 2400.0
    narrow = sorted(f for f, z in points if z < 5e-3)
    assert narrow[0] < 400.0 < 700.0 < narrow[-1]
    # Neighbouring grid points are at most 2.5 half-widths apart.
    assert max(b / a for a, b in pairwise(narrow)) < 1.0 + 2.5 * 1.5e-3


@pytest.mark.usefixtures("brief_records")
def test_a_mode_within_the_resonance_of_a_plant_mode_is_refused() -> None:
    hidden = hide("left-out", LIBRARY.index("pickoff_crosstalk"), 1)
    selection = forward_selection(
        RestrictedProblem(campaign_answers(hidden.campaign, threads=1).problem, hidden.left_out)
    )
    assert NAME not in selection.last.fit.terms
