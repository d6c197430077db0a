"""The noise of the pick-offs as the silent record shows it, for the rate noise of the device in operation.

    e^2 = mean over the pick-offs of the one-sided density at omega0,      sd(ln e) = 1/2 relative sd of the density / sqrt(S)

It holds where the electronics in operation are those of the test; [operation] pickoff_noise_v declares others.
Draw i takes the i-th of n normal nodes in a fixed order, so that the interval contains the uncertainty of e.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from ..arrays import FloatArray
from ..experiment.noise.spectrum import NoiseSpectrum
from .estimate import RateSettings

#: Seed of the order of the nodes: points of an integral, not realisations.
_SEED = 29


@lru_cache(maxsize=8)
def _nodes(count: int) -> FloatArray:
    nodes = ndtri((np.arange(count) + 0.5) / count)
    random = np.random.default_rng(np.random.SeedSequence(_SEED, spawn_key=(count,)))
    return np.asarray(random.permutation(nodes))


def with_measured_noise(rate: RateSettings, noise: NoiseSpectrum, f0_hz: float, draws: int) -> RateSettings:
    """The settings with e (draws,) [V/sqrt(Hz)] at ``f0_hz`` [Hz], unless e is declared or nothing depends on it."""
    operation = rate.operation
    if operation.pickoff_noise_v is not None or operation.drive_amplitude_v is None or rate.angular_gain is None:
        return rate
    at = np.array([f0_hz])
    density, spread = noise.psd(at)[0], noise.relative_sd(at)[0]
    level = np.sqrt(np.mean(density))
    sd = 0.5 * float(np.linalg.norm(density * spread) / np.sum(density))
    return replace(rate, operation=replace(operation, pickoff_noise_v=level * np.exp(sd * _nodes(draws))))
