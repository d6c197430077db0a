"""Simulation of a record: N samples, S senses, D drives, P poles (modes and anti-alias filter)."""

import numpy as np
import pytest
from bench.device import bank_of, device
from scipy import signal

from pipeline.experiment.forward.modal_bank import respond
from workflows.screening.virtual_device import virtual_volts

PART, BANK = "simulation", "modal bank"


def bank():
    return bank_of(device().fitted[0].scoring.fit.x, device().instrument)


def states(bank):
    """Real state space of a bank: two states per pole and drive, S = 2 Re sum_k R_k x_k."""
    poles, residues = bank.poles[0], bank.residues[0]
    count, senses, drives = residues.shape
    a, b = np.zeros((2 * count * drives,) * 2), np.zeros((2 * count * drives, drives))
    c = np.zeros((senses, 2 * count * drives))
    for k, p in enumerate(poles):
        for d in range(drives):
            i = 2 * (k * drives + d)
            a[i : i + 2, i : i + 2] = [[p.real, -p.imag], [p.imag, p.real]]
            b[i, d] = 1.0
            c[:, i], c[:, i + 1] = 2.0 * residues[k, :, d].real, -2.0 * residues[k, :, d].imag
    return a, b, c, np.zeros((senses, drives))


@pytest.fixture(scope="module")
def known():
    d = device()
    return respond(bank(), d.drive, d.rate_hz, "zoh")[0]


def bank_flops():
    _, poles, senses, drives = bank().residues.shape
    return device().drive.shape[0] * senses * poles * (8 + 4 * drives)


def test_part_simulation(timed):
    d = device()
    timed.part(PART, lambda: virtual_volts(d.config, d.drawn, 0), {"flop": bank_flops()}, "that of the modal bank")


def test_part_bank(timed):
    d, modes = device(), bank()
    timed.part(
        BANK,
        lambda: respond(modes, d.drive, d.rate_hz, "zoh"),
        {"flop": bank_flops()},
        "N S P (8 + 4 D) flops: one rotation and D drives a state",
        inside=PART,
    )


def test_peer_lsim(timed, known):
    d, system = device(), states(bank())
    t = np.arange(d.drive.shape[0]) / d.rate_hz
    found = timed.peer(
        BANK, "scipy.signal.lsim, interp=False", lambda: signal.lsim(system, d.drive, t, interp=False)[1]
    )
    assert np.max(np.abs(found - known)) < 1e-8 * np.max(np.abs(known))


def test_peer_control(timed, known):
    control = pytest.importorskip("control")
    d = device()
    sampled = control.sample_system(control.ss(*states(bank())), 1.0 / d.rate_hz, "zoh")
    t = np.arange(d.drive.shape[0]) / d.rate_hz
    found = timed.peer(
        BANK,
        "control.forced_response, sampled system",
        lambda: control.forced_response(sampled, t, d.drive.T).outputs.T,
    )
    assert np.max(np.abs(found - known)) < 1e-8 * np.max(np.abs(known))


def test_peer_lfilter(timed, known):
    d, modes = device(), bank()
    poles, residues = modes.poles[0], modes.residues[0]
    z = np.exp(poles / d.rate_hz)
    gain = np.expm1(poles / d.rate_hz) / poles
    # Each pole and drive as a real second-order section: 2 Re R g q / (1 - z q).
    weight = residues * gain[:, None, None]
    above = np.stack([2.0 * weight.real, -2.0 * (weight * np.conj(z)[:, None, None]).real], axis=-1)

    def filtered():
        out = np.zeros((d.drive.shape[0], 2))
        for k in range(z.size):
            below = [1.0, -2.0 * z[k].real, abs(z[k]) ** 2]
            for s in range(2):
                for i in range(2):
                    out[:, s] += signal.lfilter([0.0, *above[k, s, i]], below, d.drive[:, i])
        return out

    found = timed.peer(BANK, "scipy.signal.lfilter, a section per pole", filtered)
    assert np.max(np.abs(found - known)) < 1e-8 * np.max(np.abs(known))
