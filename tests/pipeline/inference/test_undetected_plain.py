"""Scores of a nightly device against plain least squares with all rows, in double precision, one effect at a time."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.special import fdtrc

from pipeline.inference.screening.inband import make_band
from pipeline.inference.screening.undetected.blocked import blocked
from pipeline.inference.screening.undetected.bounds import Projection
from pipeline.inference.screening.undetected.clipping import adc_sizes, transform_of_few
from pipeline.inference.screening.undetected.device import scored_device, scored_devices
from pipeline.inference.screening.undetected.library import probes_of
from pipeline.inference.screening.undetected.linear import linear_devices
from pipeline.inference.screening.undetected.linear_stages import moved_mechanics
from pipeline.inference.screening.undetected.narrow_band import (
    WHOLE_TURN,
    at_phases,
    grid_of,
    harmonics,
)
from pipeline.inference.screening.undetected.scan_bounds import judged_scans
from pipeline.inference.screening.undetected.scanned import (
    ScannedProducts,
    ScanPoints,
    scanned_products,
    scans_of,
)
from pipeline.inference.screening.undetected.signatures import along_motions, band_motion, signatures
from pipeline.inference.screening.undetected.slopes import feature_slopes
from populations.draw import draw
from workflows.config import RunConfig
from workflows.screening.settings import population
from workflows.screening.virtual_device import fit_virtual


@pytest.fixture(scope="module")
def scored():
    """A fitted device of the default run, and its scores."""
    config = RunConfig()
    spec = population(config)
    fitted = fit_virtual(config, draw(spec, 51, 0, 1), 0, float(spec.angular_gain))
    return fitted.scoring, scored_device(fitted.scoring)


def _in_sigmas(spectra, data, sigma_v):
    """Rows (K, 4 W) of spectra (K, S, W), hum lines projected out."""
    real = np.concatenate([spectra.real, spectra.imag], axis=-1)
    real = real - (real @ data.nuisance) @ data.nuisance.T
    return (real * np.sqrt(2.0 / data.band.samples) / sigma_v[:, None]).reshape(real.shape[0], -1)


def _jacobian_and_residual(device, sensed, fit, data, sigma_v, prior):
    """Rows (P + 1, 4 W + 2) in sigmas, those of the prior at the end."""
    real = device.rows(feature_slopes(fit))
    width = data.band.bins.size
    sensed = sensed[:, :width] + 1j * sensed[:, width:]
    spectra = np.concatenate(
        [real[..., :width] + 1j * real[..., width:], (data.spectrum - sensed)[None]], dtype=np.complex128
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
    scoring, found = scored
    fit, (data,), (loud,), noise, instrument = (
        scoring.fit,
        scoring.data,
        scoring.louds,
        scoring.noise,
        scoring.instrument,
    )
    (((device,), moved),) = linear_devices([fit], [[data.band]], instrument, partial(moved_mechanics, True))
    sizes = adc_sizes([loud], noise.sigma_v, instrument.bias_v, True)
    (along,) = along_motions([device], [band_motion(device)], [loud], [sizes], True)
    found_rows = signatures(device, moved, True, feature_slopes(fit), along)
    fit_rows = _jacobian_and_residual(device, found_rows.sensed, fit, data, noise.sigma_v, scoring.prior)
    dof = 2.0 / float(np.mean(noise.relative_sd(data.band.frequency_hz) ** 2))
    by_effect = {}
    for one in found_rows.signatures:
        by_effect.setdefault(one.effect, []).append(one)
    for effect, columns in by_effect.items():
        own = _in_sigmas(np.stack([one.spectrum for one in columns]), data, noise.sigma_v)
        total, k = _explained(fit_rows, np.pad(own, ((0, 0), (0, 2)))), len(columns)
        if any(one.low == 0.0 or one.high == 0.0 for one in columns):
            continue  # of one sign: half the probability, or none
        # A fall of chi2 of order 1 is the difference of two numbers of order 3600.
        assert found.p_values[effect] == pytest.approx(fdtrc(k, dof, total / k), rel=1e-6), effect
    for scan in scans_of(data.band, (400.0, 700.0), scoring.line_hz, True):
        first = 0
        for one in scan.scans:
            own = scan.columns[2 * first : 2 * (first + one.points)].astype(np.float64)
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


@pytest.mark.parametrize("peak", [0.01, 1.0, 50.0])
def test_the_size_of_a_clip_is_found_as_by_a_bisection_with_its_law(scored, peak):
    (loud,), sigma_v = scored[0].louds, scored[0].noise.sigma_v
    volts = loud[1] * (peak / np.abs(loud[1]).max())
    (probe,) = (one for one in probes_of(True, "adc") if one.effect.name == "adc_saturation")
    low, high, size = 1e-6 * probe.member.scale, probe.member.high, 0.0
    while not 15.0 < size < 60.0:
        middle = np.sqrt(low * high)
        size = np.linalg.norm((np.clip(volts, -1.0 / middle, 1.0 / middle) - volts) / sigma_v)
        low, high = (low, middle) if size > 30.0 else (middle, high)
    assert adc_sizes([(loud[0], volts)], sigma_v, 10.0, True)["adc_saturation"] == pytest.approx(middle, rel=1e-12)


def test_the_transform_of_few_samples_is_that_of_the_record(scored):
    (data,), instrument = scored[0].data, scored[0].instrument
    random = np.random.default_rng(1)
    for band in (data.band, make_band(data.band.drive_v[:2999], instrument, 430.0, 470.0)):
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
    (data,) = scored[0].data
    grid, spectrum = grid_of(data.band), data.spectrum
    np.testing.assert_allclose(
        grid.spectra(grid.envelopes(spectrum)), spectrum, rtol=1e-12, atol=1e-12 * abs(spectrum).max()
    )


def test_devices_that_are_scored_together_have_the_scores_of_each_alone_bit_for_bit(scored):
    config = RunConfig()
    spec = population(config)
    drawn = draw(spec, 51, 0, 4)
    scorings = [fit_virtual(config, drawn, i, float(spec.angular_gain)).scoring for i in range(1, 4)]
    broken = replace(scorings[1], fit=replace(scorings[1].fit, x=np.full(14, np.nan)))
    first, failed, *rest = scored_devices([scorings[0], broken, scored[0], *scorings[1:]])
    assert isinstance(failed, Exception)
    alone = [scorings[0], scored[0], *scorings[1:]]
    for together, own in zip([first, *rest], [scored_device(one) for one in alone]):
        assert together.columns() == own.columns()
        assert (together.p_values, together.bounds, together.causes) == (own.p_values, own.bounds, own.causes)


def test_a_quantity_that_nothing_can_bias_has_the_bound_zero(scored):
    scoring, found = scored
    # Without a phase error no quadrature leaks, and lines have no largest strength: zero times infinity.
    exact = scored_device(replace(scoring, rate=replace(scoring.rate, phase_error_deg=0.0)))
    assert exact.bounds["quadrature_bias_dps"] == 0.0
    assert found.bounds["quadrature_bias_dps"] > 0.0
    for name in ("theta_deg", "split_hz", "inphase_bias_dps"):
        assert exact.bounds[name] == found.bounds[name] > 0.0


def test_a_scanned_column_that_the_drive_does_not_reach_says_nothing():
    random = np.random.default_rng(7)
    jacobian, residual = random.normal(size=(2, 40)), random.normal(size=40)
    columns = random.normal(size=(2, 2, 2, 40))
    columns[1, 1] = 0.0  # both columns of the second channel at the second point
    base = np.vstack([jacobian, residual]) @ np.vstack([jacobian, residual]).T
    cross = np.einsum("rn,sgkn->rsgk", np.vstack([jacobian, residual]), columns)
    squares = np.einsum("sgan,sgbn->sgab", columns, columns)[:, :, [0, 0, 1], [0, 1, 1]]
    scan = ScanPoints("mains_hum", 2, np.zeros(0), np.inf)
    slopes = np.array([[1.0, 0.5], [0.0, 0.0]])
    projection = Projection.of(base[:2, :2], slopes)
    found = judged_scans(ScannedProducts((scan,), base, cross, squares), projection, base[:2, 2], 1e9)
    assert np.isfinite(found.bounds).all()
    assert found.bounds[0, 0] > 0.0
    assert found.bounds[0, 1] == 0.0
    assert 0.0 < found.p_values[0] <= 1.0


def _scan_of(scoring):
    (scan,) = scans_of(scoring.data[0].band, (400.0, 700.0), scoring.line_hz, True)
    return scan


def test_products_by_blocks_are_those_of_all_columns(scored):
    scan = _scan_of(scored[0])
    blocks, width = scan.blocks, scan.columns.shape[1]
    columns = scan.columns.reshape(-1, 2, width).swapaxes(0, 1).reshape(-1, width).astype(np.float64)
    mixed, first = np.zeros_like(columns).reshape(-1, 2, width // 2), 0
    for begin, end, basis in zip(blocks.edges, blocks.edges[1:], blocks.bases):
        np.testing.assert_allclose(basis.T.astype(float) @ basis, np.eye(basis.shape[1]), atol=1e-5)
        own = blocks.mix[first : first + basis.shape[1]].T.astype(float) @ basis.T
        mixed[:, :, begin:end], first = own.reshape(-1, 2, end - begin), first + basis.shape[1]
    left = columns - mixed.reshape(columns.shape)
    norm = np.linalg.norm(columns, axis=1)
    for begin, end in zip(blocks.edges, blocks.edges[1:]):
        own = left.reshape(-1, 2, width // 2)[:, :, begin:end].reshape(norm.size, -1)
        assert np.all(np.linalg.norm(own, axis=1) <= 1.1e-5 * norm)
    assert first < 0.3 * width  # bases that kept everything would be right as well
    # Rows that are random, smooth, what is left out, or columns themselves.
    random = np.random.default_rng(8)
    rows = np.concatenate([random.standard_normal((5, width)), np.ones((1, width)), left[::9], columns[::9]])
    exact = rows @ columns.T
    limit = np.sqrt(6.0) * 1.1e-5 * np.linalg.norm(rows, axis=1)[:, None] * norm
    for own in (rows, rows.astype(np.float32)):
        assert np.all(np.abs(blocks.products(own) - exact) <= limit)


def test_columns_of_which_few_bins_are_not_zero_are_mixtures_too():
    columns = np.zeros((40, 240), dtype=np.float32)
    columns[:30, 100:102] = np.random.default_rng(9).standard_normal((30, 2))
    rows = np.random.default_rng(10).standard_normal((3, 240))
    np.testing.assert_allclose(blocked(columns).products(rows), rows @ columns.T, rtol=0.0, atol=1e-4)


def test_columns_that_are_independent_are_no_mixtures():
    random = np.random.default_rng(11)
    assert blocked(random.standard_normal((40, 240)).astype(np.float32)) is None
    assert blocked(random.standard_normal((2, 8)).astype(np.float32)) is None


@pytest.mark.parametrize("coloured", [False, True])
def test_scans_have_the_scores_of_all_columns(scored, coloured):
    scoring, _ = scored
    (data,), scan, random = scoring.data, _scan_of(scoring), np.random.default_rng(12)
    (((device,), _),) = linear_devices([scoring.fit], [[data.band]], scoring.instrument, partial(moved_mechanics, True))
    weight = np.full((2, data.band.bins.size), np.sqrt(2.0 / data.band.samples)) / scoring.noise.sigma_v[:, None]
    if coloured:
        weight = weight * np.geomspace(0.5, 2.0, data.band.bins.size)
    noise = random.standard_normal((1, 2, 2 * data.band.bins.size)) / np.tile(weight, 2)
    rows = np.concatenate([device.rows(feature_slopes(scoring.fit)), noise])
    flat = (rows * np.tile(weight, 2)).reshape(rows.shape[0], -1)
    base = flat @ flat.T
    # Without its prior the fit does not know the mismatches.
    projection = Projection.of(base[:-1, :-1] + 1e-9 * np.diag(np.diag(base[:-1, :-1])), random.normal(size=(3, 14)))
    by_blocks, whole = (
        judged_scans(scanned_products([one], rows, weight, base), projection, base[:-1, -1], 1e4)
        for one in (scan, replace(scan, blocks=None))
    )
    assert scan.blocks is not None
    np.testing.assert_allclose(by_blocks.p_values, whole.p_values, rtol=1e-4)
    np.testing.assert_allclose(by_blocks.bounds, whole.bounds, rtol=1e-4)
