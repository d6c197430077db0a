"""The likelihood of one chirp record in plain numpy: exact, vectorised over the bins, nothing compressed or compiled.

    Y(w) = sum_k R_k X(w; p_k) + conj(R_k) X(w; conj p_k),   X = (g V(w) - e^{iw} x_N) / (e^{iw} - z),  g = (z - 1) / p
    x_N = g sum_n z^{N-1-n} v[n]

with the poles p_k of the modes and of the anti-alias filter, zero-order hold.  Source: pipeline.inference.screening.inband.
"""

from __future__ import annotations

import numpy as np
from bench.device import bank_of, device

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.inference.screening.compressed import BandData
from pipeline.inference.screening.likelihood import allowed
from pipeline.inference.screening.mismatch import MismatchPrior

_BLOCK = 256


def _driven(poles: ComplexArray, data: BandData) -> ComplexArray:
    """X (P, D, W) of poles (P,) [rad/s]."""
    band = data.band
    step = 1.0 / band.sample_rate_hz
    z, gain = np.exp(poles * step), np.expm1(poles * step) / poles
    blocks = -(-band.samples // _BLOCK)
    late = np.zeros((blocks * _BLOCK, band.drive_v.shape[1]))
    late[: band.samples] = band.drive_v[::-1]
    powers = z[:, None] ** np.arange(_BLOCK)
    sums = np.tensordot(powers, late.reshape(blocks, _BLOCK, -1), axes=(1, 1))
    ends = np.einsum("pb,pbd->pd", np.exp(np.log(z)[:, None] * _BLOCK * np.arange(blocks)), sums)
    over = gain[:, None, None] / (band.e_iw - z[:, None, None])
    return np.asarray((band.now - band.e_iw * ends[:, :, None]) * over)


def residuals(x: FloatArray, data: BandData, sigma_v: FloatArray, prior: MismatchPrior) -> FloatArray:
    """(data - model) / sigma (4 W + 2,) at parameters x (14,), hum lines projected out, and those of the prior."""
    bank = bank_of(x, device().instrument)
    poles = np.concatenate([bank.poles[0], np.conj(bank.poles[0])])
    residues = np.concatenate([bank.residues[0], np.conj(bank.residues[0])])
    model = np.einsum("psd,pdw->sw", residues, _driven(poles, data))
    rest = (data.spectrum - model) * np.sqrt(2.0 / data.band.samples) / sigma_v[:, None]
    stacked = np.concatenate([rest.real, rest.imag], axis=1)
    stacked -= (stacked @ data.nuisance) @ data.nuisance.T
    root, offset = prior.rows()
    return np.concatenate([stacked.ravel(), offset - root @ x[12:]])


def log_posterior(x: FloatArray, data: BandData, sigma_v: FloatArray, prior: MismatchPrior) -> float:
    """-chi2 / 2 [1] at x (14,), -inf outside the support of the prior."""
    if not allowed(x):
        return -np.inf
    rest = residuals(x, data, sigma_v, prior)
    return -0.5 * float(rest @ rest)
