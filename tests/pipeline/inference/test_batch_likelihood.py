"""The likelihood of many points at once is that of one point after the other, and few rows of it are enough."""

import numpy as np
import pytest

from pipeline.device import gyro_batch
from pipeline.device.gyro import cartesian_modes
from pipeline.inference.screening.batch import local_rows, whole_rows
from pipeline.inference.screening.likelihood import allowed, residual_rows
from pipeline.inference.screening.sample import _sufficient_rows, _t_draws
from workflows.config import RunConfig
from workflows.screening import virtual_device
from workflows.screening.block import DeviceBlock, virtual_block


@pytest.fixture(scope="module")
def fits():
    """Fits of devices of the default run, and draws (n, 14) around each."""
    found = []
    fitted = virtual_device.fit_device

    def kept(*arguments):
        result = fitted(*arguments)
        found.append(result.scoring.fit)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(virtual_device, "fit_device", kept)
        virtual_block(RunConfig(), DeviceBlock(0, 0, 3))
    out = []
    for fit in found:
        scale = np.sqrt(np.diag(fit.covariance))
        factor = np.linalg.cholesky(fit.covariance / np.outer(scale, scale)) * scale[:, None]
        out.append((fit, fit.x + _t_draws(600, 14, np.random.default_rng(1)) @ factor.T))
    return out


def one_by_one(fit, points):
    """-chi2/2 of each point by the residuals of the fit."""
    found = [float(np.sum(residual_rows(x, *fit.likelihood.arrays)[0] ** 2)) for x in points]
    return np.where([allowed(x) for x in points], -0.5 * np.array(found), -np.inf)


def test_the_likelihood_of_many_points_is_that_of_each(fits):
    for fit, points in fits:
        np.testing.assert_allclose(
            whole_rows(fit.likelihood).log_likelihood(points), one_by_one(fit, points), atol=1e-6
        )


def test_few_rows_give_the_likelihood_near_the_maximum(fits):
    for fit, points in fits:
        few = local_rows(fit.likelihood, fit.x)
        assert few.target.size == 16 < whole_rows(fit.likelihood).target.size
        np.testing.assert_allclose(few.log_likelihood(points), one_by_one(fit, points), atol=1e-5)


def test_all_rows_are_used_where_few_do_not_suffice(fits):
    fit, points = fits[0]
    assert _sufficient_rows(fit, points[:64]).target.size == 16
    # Ten hertz away the few rows leave most of chi2 out.
    far = points[:64] + np.eye(14)[0] * 60.0
    assert _sufficient_rows(fit, far).target.size == whole_rows(fit.likelihood).target.size


def test_points_outside_of_the_support_are_excluded(fits):
    fit, points = fits[0]
    outside = points[:4].copy()
    outside[0, 3], outside[1, 7], outside[2, 10] = -1.0, -1.0, 1.5
    found = whole_rows(fit.likelihood).log_likelihood(outside)
    assert np.all(found[:3] == -np.inf)
    assert np.isfinite(found[3])


@pytest.mark.parametrize("size", [12, 14])
def test_modes_of_many_devices_are_those_of_each(size):
    random, count = np.random.default_rng(2), 501
    # Splits from nearly an exceptional point to 10 Hz, and one at it: the same frequencies and dampings.
    eps, angle = 2.0 * np.pi * 10.0 ** random.uniform(-6.0, 1.0, count), random.uniform(0.0, 2.0 * np.pi, count)
    rate, of_rate = random.uniform(0.5, 5.0, count), random.uniform(0.0, 0.4, count)
    x = 0.02 * random.standard_normal((size, count))
    x[0], x[1], x[2] = 2.0 * np.pi * random.uniform(500.0, 600.0, count), eps * np.cos(angle), eps * np.sin(angle)
    x[3], x[4], x[5] = rate, rate * of_rate * np.sin(angle), rate * of_rate * np.cos(angle)
    x[6], x[7] = 2.0 * np.pi * random.uniform(580.0, 620.0, count), random.uniform(0.5, 5.0, count)
    x[1:3, 0] = x[4:6, 0] = 0.0
    poles, residues = np.empty((3, 2, count)), np.empty((3, 2, 2, 2, count))
    gyro_batch.batch_modes(x, np.exp(x[8:10]), poles, residues)
    own_poles, own_residues = np.empty(3, dtype=complex), np.empty((3, 2, 2), dtype=complex)
    for n in range(count):
        cartesian_modes(np.ascontiguousarray(x[:, n]), own_poles, own_residues)
        # Coinciding poles are known to the square root of rounding, and residues are inverse to their distance.
        apart = abs(own_poles[0] - own_poles[1])
        scale = np.max(np.abs(own_residues))
        np.testing.assert_allclose(
            poles[:, 0, n] + 1j * poles[:, 1, n], own_poles, rtol=0.0, atol=1e-11 + 1e-12 / apart
        )
        np.testing.assert_allclose(
            residues[:, :, :, 0, n] + 1j * residues[:, :, :, 1, n],
            own_residues,
            rtol=0.0,
            atol=(1e-11 + 1e-11 / apart) * scale,
        )
