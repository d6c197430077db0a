"""The paper's route: bandpass, ARX fit, modes and axes: N samples, C = 4 channels, S senses, order n, L biquads."""

import numpy as np
import pytest
from bench.device import device
from scipy import signal

from pipeline.identification.arx import fit_arx
from pipeline.identification.bandpass import bandpass, bandpass_sections
from pipeline.identification.route import identify_record

ROUTE, BAND, ARX = "paper's route", "bandpass", "ARX fit"
ORDER, SENSES = 40, 2
BAND_HZ = (400.0, 700.0)


def bandpass_flops():
    samples, channels = device().both.shape
    return samples * channels * 4 * 9


def arx_flops():
    samples, channels = device().window.shape
    size = ORDER * channels
    return 2 * samples * channels**2 * (ORDER + 1) + size**3 / 3 + 2 * size**2 * SENSES


def test_part_bandpass(timed):
    d, both = device(), device().both
    timed.part(
        BAND,
        lambda: bandpass(both, d.rate_hz, *BAND_HZ),
        {"flop": bandpass_flops()},
        "9 N C L flops",
        inside=ROUTE,
    )


def test_peer_sosfilt(timed):
    d, both = device(), device().both
    sections = bandpass_sections(d.rate_hz, *BAND_HZ).copy()  # scipy takes no read-only array
    found = timed.peer(BAND, "scipy.signal.sosfilt", lambda: signal.sosfilt(sections, both, axis=0))
    assert np.allclose(found, bandpass(both, d.rate_hz, *BAND_HZ), rtol=1e-9, atol=1e-12)


def test_part_arx(timed):
    window = device().window
    timed.part(
        ARX,
        lambda: fit_arx(window[:, :SENSES], window[:, SENSES:], ORDER),
        {"flop": arx_flops()},
        "2 N C^2 (n + 1) + (n C)^3 / 3 + 2 (n C)^2 S flops: first block row, Cholesky, solution",
        inside=ROUTE,
    )


def test_peer_lstsq(timed):
    window = device().window

    def work():
        past = [window[ORDER - k : -k] for k in range(1, ORDER + 1)]
        return np.linalg.lstsq(np.concatenate(past, axis=1), window[ORDER:, :SENSES], rcond=None)[0]

    timed.peer(ARX, "numpy.linalg.lstsq", work)


def test_part_route(timed):
    d = device()
    found = timed.part(
        ROUTE,
        lambda: identify_record(d.record, d.instrument, ORDER, BAND_HZ),
        {"flop": bandpass_flops() + arx_flops()},
        "bandpass and ARX fit",
    )
    truth = d.drawn.true["f1_hz"][0]
    assert abs(found.f_hz[0] - truth) < 0.1


def test_peer_mdof(timed):
    mdof = pytest.importorskip("mdof")
    senses, drives = device().window[:, :SENSES].T.copy(), device().window[:, SENSES:].T.copy()
    timed.peer(
        ROUTE,
        "mdof SRIM, horizon 80, order 12",
        lambda: mdof.system(drives, senses, dt=1e-4, method="srim", order=12, horizon=80),
        note="from the window; no bandpass, no axes",
    )


def test_peer_sippy(timed):
    sippy = pytest.importorskip("sippy_unipi")
    senses, drives = device().window[:, :SENSES].T.copy(), device().window[:, SENSES:].T.copy()
    timed.peer(
        ROUTE,
        "sippy_unipi N4SID, horizon 40, order 12",
        lambda: sippy.system_identification(senses, drives, "N4SID", tsample=1e-4, SS_fixed_order=12, SS_f=40, SS_p=40),
        note="from the window; no bandpass, no axes",
    )
