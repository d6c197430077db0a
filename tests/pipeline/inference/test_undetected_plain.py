"""Scores of a nightly device against plain least squares with all rows, in double precision, one effect at a time."""

from functools import partial

import numpy as np
import pytest
from scipy.special import fdtrc

from pipeline.inference.screening import device as screening
from pipeline.inference.screening.inband import make_band
from pipeline.inference.screening.undetected.clipping import adc_sizes, loud_samples, transform_of_few
from pipeline.inference.screening.undetected.device import feature_slopes
from pipeline.inference.screening.undetected.linear import linear_devices
from pipeline.inference.screening.undetected.linear_stages import moved_mechanics
from pipeline.inference.screening.undetected.narrow_band import (
    WHOLE_TURN,
    at_phases,
    grid_of,
    harmonics,
    motion_at_phases,
)
from pipeline.inference.screening.undetected.scanned import scans_of
from pipeline.inference.screening.undetected.signatures import signatures
from populations.draw import draw
from workflows.config import RunConfig
from workflows.screening.settings import population
from workflows.screening.virtual_device import identify_virtual


@pytest.fixture(scope="module")
def scored():
    """What a device of the default run gives the scores, and its scores."""
    config, calls = RunConfig(), []
    spec, original = population(config), screening.scored_device

    def spied(*arguments):
        calls.append((arguments, original(*arguments)))
        return calls[-1][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(screening, "scored_device", spied)
        identify_virtual(config, draw(spec, 51, 0, 1), 0, float(spec.angular_gain))
    return calls[0]


def _in_sigmas(spectra, data, sigma_v):
    """Rows (K, 4 W) of spectra (K, S, W), hum lines projected out."""
    real = np.concatenate([spectra.real, spectra.imag], axis=-1)
    real = real - (real @ data.nuisance) @ data.nuisance.T
    return (real * np.sqrt(2.0 / data.band.samples) / sigma_v[:, None]).reshape(real.shape[0], -1)


def _jacobian_and_residual(device, fit, data, sigma_v, prior):
    """Rows (P + 1, 4 W + 2) in sigmas, those of the prior at the end."""
    real = device.rows(feature_slopes(fit))
    width = data.band.bins.size
    spectra = np.concatenate(
        [real[..., :width] + 1j * real[..., width:], (data.spectrum - device.sensed)[None]], dtype=np.complex128
    )
    root, offset = prior.rows()
    of_prior = np.zeros((spectra.shape[0], 2))
    of_prior[12:14], of_prior[-1] = root.T, offset - root @ fit.x[12:]
    return np.concatenate([_in_sigmas(spectra, data, sigma_v), of_prior], axis=1)


def _explained(fit_rows, effect_rows):
    """Fall of chi2 by columns (k, n) beside the fit (P + 1, n), whose last row is the residual."""
    unit = [rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (fit_rows[:-1], effect_rows)]
    chi2 = [
        np.sum((fit_rows[-1] - columns @ np.linalg.lstsq(columns, fit_rows[-1], rcond=None)[0]) ** 2)
        for columns in (unit[0].T, np.concatenate(unit).T)
    ]
    return chi2[0] - chi2[1]


def test_scores_are_those_of_plain_least_squares(scored):
    (fit, (data,), (model_v,), noise, instrument, _, prior, line_hz), found = scored
    (device,), moved = linear_devices(fit, [data.band], instrument, partial(moved_mechanics, True))
    loud = loud_samples(model_v)
    sizes = adc_sizes([loud], noise.sigma_v, instrument.bias_v, True)
    fit_rows = _jacobian_and_residual(device, fit, data, noise.sigma_v, prior)
    dof = 2.0 / float(np.mean(noise.relative_sd(data.band.frequency_hz) ** 2))
    by_effect = {}
    for one in signatures(device, moved, loud, sizes, True):
        by_effect.setdefault(one.effect, []).append(one)
    for effect, columns in by_effect.items():
        own = _in_sigmas(np.stack([one.spectrum for one in columns]), data, noise.sigma_v)
        total, k = _explained(fit_rows, np.pad(own, ((0, 0), (0, 2)))), len(columns)
        if any(one.low == 0.0 or one.high == 0.0 for one in columns):
            continue  # of one sign: half the probability, or none
        # A fall of chi2 of order 1 is the difference of two numbers of order 3600.
        assert found.p_values[effect] == pytest.approx(fdtrc(k, dof, total / k), rel=1e-6), effect
    for scan in scans_of(data.band, (400.0, 700.0), line_hz, True):
        first = 0
        for one in scan.scans:
            own = scan.columns[:, 2 * first : 2 * (first + one.points)].T.astype(np.float64)
            own -= (own @ data.nuisance) @ data.nuisance.T
            first += one.points
            totals = []
            for pair in own.reshape(one.points, 2, -1):
                channels = np.zeros((4, 2, pair.shape[1]))
                channels[:2, 0] = channels[2:, 1] = pair
                channels *= np.sqrt(2.0 / data.band.samples) / noise.sigma_v[:, None]
                totals.append(_explained(fit_rows, np.pad(channels.reshape(4, -1), ((0, 0), (0, 2)))))
            least = fdtrc(4.0, dof, max(totals) / 4.0)
            # The norms of scanned columns contain their parts in the hum lines, 1e-3 of them.
            assert found.p_values[one.effect] == pytest.approx(-np.expm1(one.points * np.log1p(-least)), rel=5e-3)


def test_the_transform_of_few_samples_is_that_of_the_record(scored):
    (_, (data,), *_), _ = scored
    random = np.random.default_rng(1)
    for band in (data.band, make_band(data.band.drive_v[:2999], scored[0][4], 430.0, 470.0)):
        for count in (0, 1, 40, band.samples // 2):
            where = np.sort(random.choice(band.samples, count, replace=False))
            change = random.standard_normal((count, 2))
            record = np.zeros((band.samples, 2))
            record[where] = change
            found = transform_of_few(band, where, change)
            np.testing.assert_allclose(found, band.transform(record), atol=1e-12 * (1.0 + np.sqrt(count)))


def test_phases_and_harmonics_are_inverse_to_each_other(scored):
    random = np.random.default_rng(2)
    a = random.standard_normal((2, 3, 7)) + 1j * random.standard_normal((2, 3, 7))
    values = at_phases(a, WHOLE_TURN)
    (first,) = harmonics(values, WHOLE_TURN, 1)
    np.testing.assert_allclose(first, a, rtol=1e-13)
    q, qd = motion_at_phases(a, 3.0, WHOLE_TURN)
    np.testing.assert_array_equal(q, values)
    np.testing.assert_allclose(qd, at_phases(3j * a, WHOLE_TURN), rtol=1e-12, atol=1e-12)
    grid = grid_of(scored[0][1][0].band)
    spectrum = scored[0][1][0].spectrum
    np.testing.assert_allclose(
        grid.spectra(grid.envelopes(spectrum)), spectrum, rtol=1e-12, atol=1e-12 * abs(spectrum).max()
    )
