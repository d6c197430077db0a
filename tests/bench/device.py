"""The device whose parts are timed: device 0 of the default run, with the product of each part before it is timed.

Shapes: N samples, two drives and two senses.  Volts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.effect import Context
from pipeline.device.effects.electrode_mismatch import mechanics as mismatched
from pipeline.device.gyro import gyro_mechanics, to_physical
from pipeline.device.mechanics import modes_of
from pipeline.experiment.antialias import Bank, behind_filter
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.spectrum import NoiseSpectrum, noise_spectrum
from pipeline.experiment.record import Record
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.inference.screening.result import Fitted
from populations.draw import Draw, draw
from workflows.config import RunConfig
from workflows.screening.settings import population
from workflows.screening.virtual_device import fit_virtual, shared_record, virtual_records, virtual_volts

#: Devices that are scored together, as in a block.
TOGETHER = 8


@dataclass(frozen=True, eq=False)
class Device:
    """Draw of ``TOGETHER`` devices, and of the first one: volts, records (N, 2) [V], bandpassed window (n, 4), noise."""

    config: RunConfig
    drawn: Draw
    gain: float
    volts: FloatArray
    silent: FloatArray
    sensed: FloatArray
    sigma_v: float
    window: FloatArray
    noise: NoiseSpectrum

    @property
    def fitted(self) -> tuple[Fitted, ...]:
        """All devices of the draw, with their fits and posteriors; computed once."""
        return _fitted()

    @property
    def instrument(self) -> Instrument:
        """Of the run."""
        return self.config.instrument.instrument()

    @property
    def rate_hz(self) -> float:
        """f_s [Hz]."""
        return self.instrument.sample_rate_hz

    @property
    def drive(self) -> FloatArray:
        """(N, 2) [V]."""
        return shared_record(self.config).record.drive_v

    @property
    def record(self) -> Record:
        """The chirp record."""
        return Record("chirp", self.rate_hz, self.drive, self.sensed, role="fit")

    @property
    def both(self) -> FloatArray:
        """Senses, then drives (N, 4) [V]."""
        return np.concatenate([self.sensed, self.drive], axis=1)


@lru_cache(maxsize=1)
def device() -> Device:
    """The device, computed once."""
    config = RunConfig()
    spec = population(config)
    gain = float(spec.angular_gain)
    drawn = draw(spec, config.run.seed, 0, TOGETHER)
    silent, sensed, sigma_v = virtual_records(config, drawn, 0)
    rate, drive = config.instrument.sample_rate_hz, shared_record(config).record.drive_v
    low, high = config.identification.low_hz, config.identification.high_hz
    filtered = bandpass(np.concatenate([sensed, drive], axis=1), rate, low, high)
    window = filtered[window_slice(filtered[:, :2], rate, config.identification.window_s)]
    noise = noise_spectrum(silent, rate, config.line_hz(), config.instrument.instrument().adc)
    volts = virtual_volts(config, drawn, 0)
    return Device(config, drawn, gain, volts, silent, sensed, sigma_v, window, noise)


@lru_cache(maxsize=1)
def _fitted() -> tuple[Fitted, ...]:
    d = device()
    fitted = [fit_virtual(d.config, d.drawn, i, d.gain) for i in range(TOGETHER)]
    good = tuple(one for one in fitted if isinstance(one, Fitted))
    assert len(good) == TOGETHER, "every device of the benchmark is fitted"
    return good


def bank_of(x: FloatArray, instrument: Instrument) -> Bank:
    """Poles and residues of a device of parameters x (14,), the anti-alias filter included."""
    mechanics = gyro_mechanics(to_physical(x[None, :12]))
    plant = {"sense_imbalance": x[10], "drive_imbalance": x[11]}
    mechanics = mismatched(mechanics, x[12:], Context(instrument.bias_v, instrument.bias_v, plant))
    return behind_filter(modes_of(mechanics), instrument.antialias)
