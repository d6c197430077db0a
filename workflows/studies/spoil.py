"""Bad samples as a faulty connector or logger leaves them, put into sound records.

Of the bad samples of each channel, half form one stuck stretch and half are spikes, of either sign, with sizes log-uniform
between ``SPIKES_V``: the smallest is ten times the noise of the default run.

Shapes: N samples, S senses; volts.
"""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.experiment.instrument import Adc

SPIKES_V = (0.01, 0.3)


def spoilt(sense_v: FloatArray, share: float, adc: Adc | None, random: np.random.Generator) -> FloatArray:
    """A copy of sense (N, S) [V] with a ``share`` [1] of bad samples in each channel, on the grid of the ADC."""
    out = sense_v.copy()
    samples = out.shape[0]
    half = round(0.5 * share * samples)
    for y in out.T:
        first = int(random.integers(1, samples - half - 1))
        y[first : first + half] = y[first - 1]
        at = random.choice(samples, half, replace=False)
        sizes = np.exp(random.uniform(np.log(SPIKES_V[0]), np.log(SPIKES_V[1]), half)) * random.choice(
            [-1.0, 1.0], half
        )
        y[at] += sizes if adc is None else np.rint(sizes / adc.lsb_v) * adc.lsb_v
    return out
