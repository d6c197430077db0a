"""Maximum likelihood in the band from the modes of the route, and the quality of the fit in the full band.

N samples, S senses, W bins, J = 48 features, P = 14 parameters.
"""

import numpy as np
from bench.device import device
from bench.naive import residuals
from bench.primitives import transforms
from scipy.optimize import least_squares

from pipeline.identification.route import identify_record
from pipeline.inference.screening.compressed import BandData
from pipeline.inference.screening.device import best_fit, model_volts
from pipeline.inference.screening.fit import start_from_modes
from pipeline.inference.screening.likelihood import FEATURES
from pipeline.inference.screening.mismatch import with_mismatch
from pipeline.inference.screening.quality import full_band_quality
from workflows.screening.virtual_device import shared_record

PART, QUALITY = "likelihood fit", "full-band quality"


def parts_of_fit():
    d, scoring = device(), device().fitted[0].scoring
    route = identify_record(d.record, d.instrument)
    return d, shared_record(d.config), scoring, start_from_modes(route.poles, route.residues)


def test_part_fit(timed):
    d, shared, scoring, start = parts_of_fit()

    def work():
        data = [BandData(shared.band, shared.band.transform(d.sensed), shared.nuisance, None)]
        return best_fit(data, d.noise.sigma_v, [start], scoring.prior)

    rows, size = 2 * shared.band.bins.size, scoring.fit.x.size
    flops = 4 * rows * FEATURES**2 - 4 * FEATURES**3 / 3 + 2 * 2 * size * 2 * FEATURES**2 / 2
    found = timed.part(
        PART,
        work,
        {"transform": transforms(*d.sensed.shape), "flop": flops},
        "one transform of the record; Q and R of one expansion, 4 (2 W) J^2 - 4 J^3 / 3, and one Jacobian, 2 P S J^2 flops",
    )
    assert found.converged


def test_peer_least_squares(timed):
    d, _, scoring, start = parts_of_fit()
    (data,) = scoring.data
    scale = np.sqrt(np.diag(scoring.fit.covariance))
    x0 = with_mismatch(start, scoring.prior)

    def work():
        return least_squares(
            lambda x: residuals(x, data, d.noise.sigma_v, scoring.prior), x0, x_scale=scale, method="lm", xtol=1e-10
        )

    found = timed.peer(PART, "scipy.optimize.least_squares, plain numpy residuals", work)
    assert 2.0 * found.cost < 1.001 * scoring.fit.chi2 + 1.0


def test_part_quality(timed):
    d, fit = device(), device().fitted[0].scoring.fit
    bank_flops = d.drive.shape[0] * 2 * 7 * 16

    def work():
        model = model_volts(fit.x, d.drive, d.instrument)
        return full_band_quality([d.record], [model], d.noise, d.config.line_hz())

    timed.part(
        QUALITY,
        work,
        {"flop": bank_flops + 6 * d.sensed.size},
        "simulation; difference, mean, lines removed and squares of the residual",
    )
