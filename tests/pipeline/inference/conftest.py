"""Virtual devices for the tests of inference."""

from dataclasses import dataclass

import numpy as np
import pytest

from pipeline.device.gyro import gyro_modes
from pipeline.experiment.antialias import behind_filter
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.noise.measure import Hum, measured
from pipeline.experiment.noise.spectrum import white_spectrum
from pipeline.experiment.record import Record
from pipeline.inference.estimate import RateSettings
from pipeline.inference.gate import Gate
from pipeline.inference.screening.device import (
    FitRecord,
    IdentificationSettings,
    identify_device,
    prepare,
)
from pipeline.inference.screening.sample import SamplerSettings

RATE = 10_000.0


@dataclass(frozen=True)
class Bench:
    """The paper's experiment; ``identify`` chirps and identifies one device at ``snr_db``."""

    instrument: Instrument
    drive: np.ndarray
    shared: FitRecord
    settings: IdentificationSettings

    def volts(self, physical):
        bank = behind_filter(gyro_modes(np.asarray(physical)[None]), self.instrument.antialias)
        return respond(bank, self.drive, RATE, "zoh")[0]

    def sigma(self, volts, snr_db=60.0):
        return float(np.sqrt(np.mean(volts[5000:25_000] ** 2)) * 10.0 ** (-snr_db / 20.0))

    def record(self, physical, seed, snr_db=60.0):
        volts = self.volts(physical)
        sigma = self.sigma(volts, snr_db)
        random = np.random.default_rng(seed)
        y = measured(volts, RATE, sigma, Hum(60.0, (0.005, 0.002, 0.003)), self.instrument.adc, random)
        lsb = self.instrument.adc.lsb_v if self.instrument.adc else 0.0
        return y, np.full(2, np.sqrt(sigma**2 + lsb**2 / 12.0))

    def identify_record(self, y, sigma, seed=1):
        fit = FitRecord(Record("chirp", RATE, self.drive, y), self.shared.band, self.shared.nuisance)
        return identify_device(
            [fit],
            white_spectrum(sigma, RATE, 10_000),
            self.instrument,
            self.settings,
            SamplerSettings(),
            Gate(),
            RateSettings(0.7, 1.0, "f1"),
            np.random.SeedSequence(seed),
        )

    def identify(self, physical, seed, snr_db=60.0):
        return self.identify_record(*self.record(physical, seed, snr_db), seed)


@pytest.fixture(scope="session")
def bench():
    instrument = Instrument(antialias=AntiAlias(), adc=Adc())
    drive = drive_samples(Chirp(), RATE)
    settings = IdentificationSettings(line_hz=60.0)
    shared = prepare(Record("chirp", RATE, drive, np.zeros_like(drive)), instrument, settings)
    return Bench(instrument, drive, shared, settings)


@pytest.fixture
def paper_device():
    return np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007])
