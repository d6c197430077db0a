"""Quantities, intervals, status and verdict of a device: n draws of Q quantities."""

import numpy as np
from bench.device import device
from bench.primitives import comparisons

from pipeline.inference.estimate import cartesian_quantities, estimate_from, intervals
from pipeline.inference.gate import GoodnessOfFit
from pipeline.inference.screening.mismatch import without_tilt
from pipeline.inference.screening.result import DeviceResult
from workflows.screening.judging import judged

PART = "gate and summary"


def plant_draws():
    one = device().fitted[0]
    return without_tilt(one.posterior.flat(), one.scoring.prior, np.random.default_rng(5))


def test_part_summary(timed):
    d, one = device(), device().fitted[0]
    fit, draws, limits = one.scoring.fit, one.posterior.flat(), d.config.judged_by()

    def work():
        plant = without_tilt(draws, one.scoring.prior, np.random.default_rng(5))
        quantities = cartesian_quantities(plant, one.scoring.rate)
        goodness = GoodnessOfFit(one.quality.error_all_noise, fit.chi2, fit.dof, fit.likelihood.chi2_sd)
        estimate = estimate_from(quantities, goodness, one.gate)
        return estimate, judged([DeviceResult({}, estimate, fit)], limits)

    shown = len(intervals(cartesian_quantities(plant_draws(), one.scoring.rate))) // 4
    estimate, _ = timed.part(
        PART, work, {"comparison": comparisons(draws.shape[0], shown)}, "Q n log2 n comparisons of a sort"
    )
    assert estimate.status == "ok"


def test_peer_numpy_quantile(timed):
    rate = device().fitted[0].scoring.rate
    lines = [v for v in cartesian_quantities(plant_draws(), rate).values() if not np.all(np.isnan(v))]
    timed.peer(
        PART,
        "numpy.quantile, numpy.std",
        lambda: [(np.quantile(v, [0.05, 0.5, 0.95]), np.std(v)) for v in lines],
        note="from quantities; no status, no verdict",
    )
