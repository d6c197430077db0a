"""Free decays: pieces without a drive, each from its own free initial state, simulated by an integrator that shares no code."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.arrays import FloatArray
from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Campaign, Record
from workflows.learning import refine

RATE_HZ, F_HZ, ZETA = 2000.0, 100.0, 3e-3
OMEGA = 2.0 * np.pi * F_HZ


def decay(k3: float = 0.0, drag: float = 0.0, seconds: float = 2.0) -> FloatArray:
    """x'' + 2 zeta w x' + w^2 x + k3 x^3 + d |x'| x' = 0 (N,) from x = 1, x' = 0."""

    def slope(t: float, s: FloatArray) -> list[float]:
        x, v = s
        return [v, -(OMEGA**2) * x - 2.0 * ZETA * OMEGA * v - k3 * x**3 - drag * abs(v) * v]

    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.asarray(solve_ivp(slope, (0.0, t[-1]), [1.0, 0.0], "DOP853", t, rtol=1e-10, atol=1e-12).y[0])


def campaign(y: FloatArray, pieces: int, snr: float) -> Campaign:
    """``pieces`` of equal length of a decay (N,) with white noise; the second of every three is held out."""
    noisy = y + y.std() / snr * np.random.default_rng(5).standard_normal(y.size)
    parts = np.split(noisy[: y.size // pieces * pieces], pieces)
    return Campaign(
        "ring",
        tuple(
            Record(
                f"{k}", RATE_HZ, np.zeros((p.size, 0)), p[:, None], "validate" if k % 3 == 1 else "fit", at_rest=False
            )
            for k, p in enumerate(parts)
        ),
        Instrument(RATE_HZ),
    )


RESONATOR = Model(PlantSpec("modal", 1, "displacement"))


def test_a_linear_decay_is_adequate_and_gives_frequency_and_damping() -> None:
    found = refine(campaign(decay(), 4, 100.0), RESONATOR).answer
    assert (found.verdict, tuple(found.effects)) == ("adequate", ())
    for name, truth in (("f1_hz", F_HZ), ("zeta1", ZETA)):
        value, sd = found.parameters[name]
        assert abs(value - truth) < 3.5 * sd
        assert sd < 3e-3 * truth


@pytest.mark.parametrize(
    ("effect", "size", "pieces"),
    [("cubic_stiffness.k3", 0.05 * OMEGA**2, 10), ("nonlinear_damping.d", 2e-2, 6)],
)
def test_one_ring_down_names_its_effect(effect: str, size: float, pieces: int) -> None:
    law = effect.partition(".")[0]
    y = decay(k3=size) if law == "cubic_stiffness" else decay(drag=size)
    found = refine(campaign(y, pieces, 100.0), RESONATOR).answer
    assert (found.verdict, tuple(found.effects)) == ("adequate", (law,))
    assert found.ladder[1].status == "confirmed"
    value, sd = found.parameters[effect]
    assert abs(value - size) < 3.5 * sd
    assert sd < 0.02 * size
