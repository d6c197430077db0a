"""Noise that depends on the signal: sampling jitter, estimated where the model has no signal.

    r_a(t) = n_a(t) + S_a'(t) delta_a(t),     cov(delta_a, delta_b) = T_ab   [s^2],   white

Silence does not show it.  The residual above the highest harmonics of the band shows it and nothing of a missing effect of the
mechanics: high-passed to a two-sided width B, its mean square is

    E r_a r_b (t) = [a = b] sigma_a^2 + T_ab u_ab(t),     u_ab = (h^2 * S_a' S_b')(t),   h the high pass, h^2 <-> (B - |f|)/f_s

with sigma_a^2 from the silent record, so T_ab follows from a regression weighted by the variance of r_a r_b.  The component
enters the likelihood if it is significant; it never enters sigma.

Shapes: N samples, S = 2 senses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft

from ...arrays import FloatArray
from ...experiment.noise.spectrum import NoiseSpectrum

#: Smallest significance [sd] of a variance component: one false alarm in 30,000 devices.
_SIGNIFICANT = 4.0
_REWEIGHTED = 3


@dataclass(frozen=True, eq=False)
class Jitter:
    """Sampling jitter: covariance (S, S) [s^2] of the sampling instants of the channels, and its significance [sd]."""

    covariance_s2: FloatArray
    significance: float

    @property
    def jitter_s(self) -> float:
        """rms over channels [s]."""
        return float(np.sqrt(np.mean(np.diag(self.covariance_s2))))

    def variances(self, slope_v_per_s: FloatArray) -> FloatArray:
        """v (3, N) [V^2] of the channel pairs (0, 0), (0, 1), (1, 1) from dS/dt (N, S) [V/s]."""
        s, c = slope_v_per_s.T, self.covariance_s2
        return np.stack([c[0, 0] * s[0] ** 2, c[0, 1] * s[0] * s[1], c[1, 1] * s[1] ** 2])


def find_jitter(
    residual_v: FloatArray, slope_v_per_s: FloatArray, noise: NoiseSpectrum, signal_hz: float
) -> Jitter | None:
    """The jitter of a record; ``None`` where it is not significant or no frequency is free of signal.

    Parameters
    ----------
    residual_v : measured - model (N, S) [V].
    slope_v_per_s : dS/dt of the model (N, S) [V/s].
    noise : of the silence.
    signal_hz : highest frequency of the band of the signal [Hz].
    """
    samples, rate = residual_v.shape[0], noise.sample_rate_hz
    frequency = np.arange(samples // 2 + 1) * rate / samples
    # A quarter of the sample rate leaves half of the noise; above it lie only high harmonics of the signal.
    low = max(rate / 4.0, signal_hz)
    kept = (frequency > low) & (frequency < rate / 2.0)
    if np.count_nonzero(kept) < 100:
        return None
    high = irfft(rfft(residual_v.T, axis=1) * kept, n=samples, axis=1)
    sigma2 = noise.psd(frequency[kept]).sum(axis=0) * rate / samples
    silent_sd = np.sqrt(2.0 / (noise.dof * np.mean(kept))) if noise.white else noise.relative_sd(frequency[kept]).mean()
    width = rate - 2.0 * low
    s = slope_v_per_s.T
    smooth = np.maximum(width - frequency, 0.0) / rate

    def seen(product: FloatArray) -> FloatArray:
        return np.asarray(irfft(rfft(product) * smooth, n=samples))

    u = [seen(s[0] ** 2), seen(s[0] * s[1]), seen(s[1] ** 2)]
    diagonal, z = np.zeros(2), np.zeros(2)
    for a, own in ((0, u[0]), (1, u[2])):
        z[a] = _significance(high[a], own, sigma2[a], width / rate, float(silent_sd))
        for _ in range(_REWEIGHTED):
            weight = own / (sigma2[a] + diagonal[a] * np.maximum(own, 0.0)) ** 2
            diagonal[a] = max(float(weight @ (high[a] ** 2 - sigma2[a]) / (weight @ own)), 0.0)
    if not z.max() > _SIGNIFICANT:
        return None
    whole = [sigma2[0] + diagonal[0] * np.maximum(u[0], 0.0), sigma2[1] + diagonal[1] * np.maximum(u[2], 0.0)]
    weight = u[1] / (whole[0] * whole[1])
    limit = np.sqrt(diagonal[0] * diagonal[1])
    cross = float(np.clip(weight @ (high[0] * high[1]) / (weight @ u[1]), -limit, limit))
    return Jitter(np.array([[diagonal[0], cross], [cross, diagonal[1]]]), float(z.max()))


def _significance(high: FloatArray, u: FloatArray, sigma2: float, share: float, silent_sd: float) -> float:
    """(estimate of T) / sd at T = 0; the band has the ``share`` of the samples' degrees of freedom."""
    excess = float(u @ (high**2 - sigma2))
    variance = 2.0 / share * float(u @ u) * sigma2**2 + (float(u.sum()) * sigma2 * silent_sd) ** 2
    return excess / float(np.sqrt(variance))
