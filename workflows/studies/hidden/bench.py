"""Records as on a real bench: each differs from the others, and the noise is not white.

    y_k(t) = (1 + g_k) f(t - tau_k; omega (1 + phi_k)) + offset + ramp + noise,    then spikes in one record of ten

Every campaign draws the largest frequency step (0.1 to 10 ppm), start shift (a hundredth of a sample to one sample), gain step
(10 to 1000 ppm) and ramp, all log-uniform; each record then draws its own between zero and those.  Noise has an sd of 1 mV and
is white, autoregressive, 1/f, or white with timing jitter of 0.05 to 0.5 us.  Shapes: N samples; records (N, 2).  Units: volts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.signal import lfilter

from pipeline.arrays import FloatArray
from pipeline.experiment.instrument import Adc
from pipeline.experiment.noise.measure import convert
from pipeline.experiment.record import Record

SIGMA_V = 1e-3
_OFFSET_V = 2e-3
_COLOURS = ("white", "autoregressive", "1/f", "jitter")
_AR = 0.7
#: Corner of the 1/f noise [Hz]: a third of its power is above it.
_CORNER_HZ = 200.0
_SPIKED, _SPIKE_V = 0.1, 0.3


class BenchRecords:
    """The variation and the noise of one campaign, drawn from ``random``."""

    def __init__(self, random: np.random.Generator) -> None:
        def log_uniform(low: float, high: float) -> float:
            return float(np.exp(random.uniform(np.log(low), np.log(high))))

        self.frequency = log_uniform(1e-7, 1e-5)
        self.start_samples = log_uniform(1e-2, 1.0)
        self.gain = log_uniform(1e-5, 1e-3)
        self.ramp_v = log_uniform(1e-4, 5e-3)
        self.colour = _COLOURS[int(random.integers(len(_COLOURS)))]
        self.jitter_s = log_uniform(5e-8, 5e-7) if self.colour == "jitter" else 0.0

    def measured(
        self,
        empty: Sequence[Record],
        values: Mapping[str, float],
        simulate: Callable[[Mapping[str, float], Record], FloatArray],
        disturbed: Sequence[FloatArray],
        streams: Sequence[np.random.Generator],
    ) -> tuple[Record, ...]:
        """The records.

        Parameters
        ----------
        empty : with their drive samples.
        values : all parameters by name.
        simulate : the noise-free record (N, 2) [V] at parameters.
        disturbed : disturbances (N, 2) [V] of each record.
        streams : the random stream of each record.
        """
        return tuple(
            self._record(record, values, simulate, extra, random)
            for record, extra, random in zip(empty, disturbed, streams)
        )

    def _record(
        self,
        record: Record,
        values: Mapping[str, float],
        simulate: Callable[[Mapping[str, float], Record], FloatArray],
        extra: FloatArray,
        random: np.random.Generator,
    ) -> Record:
        phi = self.frequency * random.uniform(-1.0, 1.0)
        delay_s = self.start_samples * random.uniform(0.0, 1.0) / record.sample_rate_hz
        gain = self.gain * random.uniform(-1.0, 1.0, 2)
        changed = {**values, **{f"f{i}_hz": values[f"f{i}_hz"] * (1.0 + phi) for i in (1, 2, 3)}}
        changed["loop_delay.tau"] = values.get("loop_delay.tau", 0.0) + delay_s
        y = record.sense_v if record.role == "noise" else simulate(changed, record) * (1.0 + gain)
        samples = y.shape[0]
        slope = np.gradient(y, axis=0) * record.sample_rate_hz
        y = y + slope * self.jitter_s * random.standard_normal((samples, 1))
        y = y + _OFFSET_V * random.standard_normal(2)
        y = y + self.ramp_v * random.uniform(-1.0, 1.0, 2) * np.linspace(-1.0, 1.0, samples)[:, None]
        y = y + self._noise(samples, record.sample_rate_hz, random) + extra
        if record.role != "noise" and random.uniform() < _SPIKED:
            place = int(random.integers(samples - 3))
            y[place : place + 3, int(random.integers(2))] += _SPIKE_V * random.choice([-1.0, 1.0])
        return replace(record, sense_v=convert(y, Adc()))

    def _noise(self, samples: int, rate_hz: float, random: np.random.Generator) -> FloatArray:
        white = random.standard_normal((samples, 2))
        if self.colour == "autoregressive":
            # Begun a hundred samples early, so that it is stationary.
            longer = np.concatenate([random.standard_normal((100, 2)), white])
            return np.asarray(SIGMA_V * np.sqrt(1.0 - _AR**2) * lfilter([1.0], [1.0, -_AR], longer, axis=0)[100:])
        if self.colour == "1/f":
            f = np.maximum(rfftfreq(samples, 1.0 / rate_hz), rate_hz / samples)
            shape = np.sqrt(1.0 + _CORNER_HZ / f)[:, None]
            return np.asarray(SIGMA_V * irfft(rfft(white, axis=0) * shape, n=samples, axis=0))
        return SIGMA_V * white
