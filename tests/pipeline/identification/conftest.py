"""An independent simulator: one continuous state space of mechanics and filter, held exactly by a matrix exponential.

Shares no code with pipeline.experiment.simulate, which runs a bank of poles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.signal import butter, tf2ss, zpk2tf

from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

RATE = 10_000.0
INSTRUMENT = Instrument(sample_rate_hz=RATE, antialias=AntiAlias())
M_S = np.array([[-1.0, -1.0], [1.0, -1.0]])
M_D = np.array([[-1.0, 1.0], [1.0, 1.0]])


@dataclass(frozen=True)
class Gyro:
    """The paper's device, with theta and split to choose."""

    f_hz: tuple[float, float, float] = (534.5, 536.4, 590.3)
    zeta: tuple[float, float, float] = (3.167e-4, 1.586e-4, 11.70e-4)
    theta_deg: float = -33.0
    c12: float = 0.0
    rocking_gain: float = 13.2
    updown_gain: float = 28.6
    sense_imbalance: float = 0.0385
    drive_imbalance: float = 0.0007

    @property
    def poles(self) -> np.ndarray:
        """p of the three modes for c12 = 0 [rad/s]."""
        omega, zeta = 2.0 * np.pi * np.array(self.f_hz), np.array(self.zeta)
        return omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))


def chirps(samples: int = 30_000) -> np.ndarray:
    """400 to 700 Hz on drive 1, 700 to 400 Hz on drive 2, 2 V."""
    t = np.arange(samples) / RATE
    sweep = 300.0 / (2.0 * samples / RATE) * t**2
    return 2.0 * np.cos(2.0 * np.pi * np.column_stack([400.0 * t + sweep, 700.0 * t - sweep]))


def state_space(gyro: Gyro) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C of drive volts -> filtered pick-off volts, the mechanics in the x, y, z frame."""
    omega, zeta = 2.0 * np.pi * np.array(gyro.f_hz), np.array(gyro.zeta)
    c, s = np.cos(np.deg2rad(gyro.theta_deg)), np.sin(np.deg2rad(gyro.theta_deg))
    axes = block_diag(np.array([[c, -s], [s, c]]), 1.0)
    damping = np.diag(2.0 * zeta * omega)
    damping[0, 1] = damping[1, 0] = gyro.c12
    k_s = np.diag([1.0 - gyro.sense_imbalance, 1.0 + gyro.sense_imbalance])
    k_d = np.diag([1.0 - gyro.drive_imbalance, 1.0 + gyro.drive_imbalance])
    force = np.vstack([gyro.rocking_gain * M_D @ k_d, gyro.updown_gain * np.ones((1, 2)) @ k_d])
    sense = k_s @ np.hstack([M_S, np.ones((2, 1))])
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-axes @ np.diag(omega**2) @ axes.T, -axes @ damping @ axes.T]])
    b = np.vstack([np.zeros((3, 2)), force])
    s_out = np.hstack([np.zeros((2, 3)), sense])
    # One filter a channel, in the time unit 1 / corner so that its coefficients are of order one.
    corner = 2.0 * np.pi * 4800.0
    fa, fb, fc, _ = tf2ss(*zpk2tf(*butter(8, 1.0, analog=True, output="zpk")))
    fa, fb = block_diag(fa, fa) * corner, block_diag(fb, fb) * corner
    whole = np.block([[a, np.zeros((6, 16))], [fb @ s_out, fa]])
    return whole, np.vstack([b, np.zeros((16, 2))]), np.hstack([np.zeros((2, 6)), block_diag(fc, fc)])


def respond(gyro: Gyro, drive: np.ndarray) -> np.ndarray:
    """Sense samples (N, 2) from rest under a zero-order hold."""
    a, b, c = state_space(gyro)
    held = expm(np.block([[a, b], [np.zeros((2, a.shape[0] + 2))]]) / RATE)
    step, gain = held[:-2, :-2], held[:-2, -2:]
    x = np.zeros(a.shape[0])
    states = np.empty((drive.shape[0], x.size))
    for n, forced in enumerate(drive @ gain.T):
        states[n] = x
        x = step @ x + forced
    return states @ c.T


def measure(gyro: Gyro, level_db: float = np.inf, seed: int = 0) -> Record:
    """A record with white noise ``level_db`` below the rms of the last two seconds."""
    drive = chirps()
    sense = respond(gyro, drive)
    sigma = 10.0 ** (-level_db / 20.0) * np.sqrt(np.mean(sense[10_000:] ** 2, axis=0))
    noise = np.random.default_rng(seed).normal(size=sense.shape)
    return Record("simulated", RATE, drive, sense + sigma * noise)


@pytest.fixture(scope="session")
def paper_gyro() -> Gyro:
    return Gyro()


@pytest.fixture(scope="session")
def silent_noise(paper_gyro: Gyro) -> Record:
    """The paper's device without noise."""
    return measure(paper_gyro)


@pytest.fixture(scope="session")
def at_60_db(paper_gyro: Gyro) -> Record:
    return measure(paper_gyro, 60.0, seed=1)


@pytest.fixture(scope="session")
def run_gyro() -> Callable[..., Record]:
    """measure(Gyro(**changes), level_db, seed)."""

    def run(level_db: float = np.inf, seed: int = 0, **changes: object) -> Record:
        return measure(Gyro(**changes), level_db, seed)  # type: ignore[arg-type]

    return run
