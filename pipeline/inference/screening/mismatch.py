"""Electrode mismatch and up-down tilt in the nightly model: two parameters with a Gaussian prior.

The up-down mode has the imbalances s', d' and rocking has s' + m_S', d' + m_D' (effect electrode_mismatch).  A tilt t of the
up-down mode (effect updown_tilt) acts on the up-down mode as imbalances of its own,

    s' = (s - t) / (1 - s t),   d' = (d - t) / (1 - d t),   G_z' = G_z (1 - s t)(1 - d t)

so it lies inside the mismatch: m_S' = m_S + t, m_D' = m_D + t to first order.  Both cannot be free, so m' = (m_D', m_S') is
fitted under the prior that the population gives to the sums.  The tilt follows from its normal distribution given m', and the
imbalances of the electrodes and G_z from the tilt:

    t | m' ~ N(t0 + w (m' - m0), sd^2),     s = (s' + t) / (1 + s' t)

Shapes: n draws of 14 parameters: the cartesian ones of ``pipeline.device.gyro``, then m_D', m_S' [1].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...arrays import FloatArray
from ...device.gyro import CARTESIAN
from ...device.model import SCREENING_MODEL, Model

_GAIN, _S, _D = (CARTESIAN.index(name) for name in ("ln_updown_gain", "sense_imbalance", "drive_imbalance"))
#: Least sd of the prior [1]: far below what a record resolves (2e-5), so that a prior without spread stays regular.
_LEAST_SD = 1e-6

Pair = tuple[float, float]


@dataclass(frozen=True)
class MismatchPrior:
    """Prior of m' = (m_D', m_S') [1] and the distribution of the tilt given m'.

    Parameters
    ----------
    mean : m0.
    covariance : of m', row by row.
    tilt, tilt_weight, tilt_sd : t0, w and sd [1]; zero where all is counted as mismatch.
    """

    mean: Pair = (0.0, 0.0)
    covariance: tuple[Pair, Pair] = ((1e-4, 0.0), (0.0, 1e-4))
    tilt: float = 0.0
    tilt_weight: Pair = (0.0, 0.0)
    tilt_sd: float = 0.0

    def rows(self) -> tuple[FloatArray, FloatArray]:
        """Root (2, 2) and offset (2,) [1] of the prior: -2 ln p = |offset - root m'|^2."""
        root, offset = _rows(self)
        return root.copy(), offset.copy()


@lru_cache(maxsize=4)
def _rows(prior: MismatchPrior) -> tuple[FloatArray, FloatArray]:
    covariance = np.array(prior.covariance) + _LEAST_SD**2 * np.eye(2)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return root, root @ np.array(prior.mean)


#: Without a population: a spread of 1 %, the size of a mismatch that gap errors of 5 % leave after averaging over electrodes.
BROAD = MismatchPrior()
#: The nightly model for the general fit, with the broad prior.
NIGHTLY_MODEL = Model(
    effects=(*SCREENING_MODEL.effects, "electrode_mismatch"),
    prior={f"electrode_mismatch.{name}": f"normal(0.0, {BROAD.covariance[0][0] ** 0.5:g})" for name in ("m_D", "m_S")},
)


def prior_from(mismatch: FloatArray, tilt: FloatArray) -> MismatchPrior:
    """The prior from draws of a population: mismatch (n, 2) as (m_D, m_S) and tilt (n,), all [1]."""
    sums = mismatch + tilt[:, None]
    mean, covariance = sums.mean(axis=0), np.cov(sums.T)
    regular = covariance + _LEAST_SD**2 * np.eye(2)
    with_tilt = np.cov(np.column_stack([sums, tilt]).T)[2]
    weight = np.linalg.solve(regular, with_tilt[:2])
    variance = max(float(with_tilt[2] - weight @ with_tilt[:2]), 0.0)
    a, b, c, d = covariance.ravel().tolist()
    m_d, m_s = mean.tolist()
    w_d, w_s = weight.tolist()
    return MismatchPrior((m_d, m_s), ((a, b), (c, d)), float(tilt.mean()), (w_d, w_s), float(np.sqrt(variance)))


def with_mismatch(x: FloatArray, prior: MismatchPrior) -> FloatArray:
    """Parameters (14,) of the fit from cartesian ``x`` (12,) and the mean of the prior; ``x`` (14,) is kept."""
    return x if x.size == 14 else np.concatenate([x, prior.mean])


def _tilt(draws: FloatArray, prior: MismatchPrior) -> FloatArray:
    """Mean of the tilt (n,) given the mismatches of ``draws`` (n, 14)."""
    return np.asarray(prior.tilt + (draws[:, 12:] - np.array(prior.mean)) @ np.array(prior.tilt_weight))


def _plant(draws: FloatArray, t: FloatArray) -> FloatArray:
    """Cartesian parameters (n, 12) of the plant with tilts (n,) from ``draws`` (n, 14) of the fit."""
    plant = draws[:, :12].copy(order="K")
    for i in (_S, _D):
        plant[:, i] = (draws[:, i] + t) / (1.0 + draws[:, i] * t)
        plant[:, _GAIN] -= np.log1p(-plant[:, i] * t)
    return plant


def mean_plant(draws: FloatArray, prior: MismatchPrior) -> FloatArray:
    """Cartesian parameters (n, 12) of the plant from ``draws`` (n, 14), at the mean of the tilt given the mismatches."""
    return _plant(draws, _tilt(draws, prior))


def without_tilt(draws: FloatArray, prior: MismatchPrior, random: np.random.Generator) -> FloatArray:
    """Cartesian draws (n, 12) of the plant from draws (n, 14) of the fit, by a draw of the tilt for each; see the head."""
    t = _tilt(draws, prior)
    return _plant(draws, t + prior.tilt_sd * random.standard_normal(t.shape))
