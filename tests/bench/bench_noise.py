"""Noise and ADC of the silent and of the chirp record: N samples in all, S senses."""

import numpy as np
from bench.device import device
from bench.primitives import transforms
from scipy import signal

from pipeline.experiment.noise.measure import measured
from pipeline.experiment.noise.spectrum import noise_spectrum

PART, SPECTRUM = "noise and ADC", "spectrum of the silence"


def test_part_noise(timed):
    d = device()
    quiet, hum, adc = np.zeros_like(d.silent), d.config.hum_source(), d.instrument.adc
    kind = d.config.noise.noise_kind()

    def work():
        random = np.random.default_rng(3)
        return [measured(v, d.rate_hz, d.sigma_v, hum, adc, random, kind) for v in (quiet, d.volts)]

    count = quiet.size + d.volts.size
    timed.part(PART, work, {"normal": count}, "N S normals")


def test_peer_numpy(timed):
    d = device()
    adc = d.instrument.adc

    def work():
        random = np.random.default_rng(3)
        clean = (np.zeros_like(d.silent), d.volts)
        return [np.round((v + random.normal(0.0, d.sigma_v, v.shape)) / adc.lsb_v) * adc.lsb_v for v in clean]

    timed.peer(PART, "numpy: normal, round", work)


def test_part_spectrum(timed):
    d = device()
    line_hz, adc = d.config.line_hz(), d.instrument.adc
    timed.part(
        SPECTRUM,
        lambda: noise_spectrum(d.silent, d.rate_hz, line_hz, adc),
        {"transform": transforms(*d.silent.shape)},
        "one transform of the silent record",
    )


def test_peer_welch(timed):
    d = device()
    timed.peer(
        SPECTRUM,
        "scipy.signal.welch, 1024 samples",
        lambda: signal.welch(d.silent, d.rate_hz, nperseg=1024, axis=0)[1],
        note="no lines, no test for white noise",
    )
