"""The integrated response equals the exact one wherever both apply."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.device.effect import Laws
from pipeline.device.mechanics import Mechanics
from pipeline.device.model import Model, PlantSpec
from pipeline.device.readout import plain_readout
from pipeline.experiment.antialias import filter_poles
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.first_order import perturbed_motion
from pipeline.experiment.forward.integrate import SUBSTEPS, linear_motion, trajectory
from pipeline.experiment.forward.linear import SampleClock, linear_response, upper_poles
from pipeline.experiment.forward.readout_filter import filtered
from pipeline.experiment.instrument import AntiAlias

RATE = 10_000.0
PLANT = Model(PlantSpec("modal", 3, "velocity", 1, 2)).built
VALUES = {"f1_hz": 534.5, "f2_hz": 536.4, "f3_hz": 590.3, "zeta1": 3e-4, "zeta2": 2e-4, "zeta3": 1e-3} | {
    f"gain{k}_s1d{d}": gain
    for k, d, gain in [(1, 1, 7.0), (1, 2, -2.0), (2, 1, 3.0), (2, 2, 6.0), (3, 1, 5.0), (3, 2, 4.9)]
}
DRIVE = drive_samples(Chirp((500.0, 620.0), (620.0, 500.0), (2.0, 2.0), 0.3), RATE)


def spring(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for i in range(q.size):
        for j in range(q.size):
            out[i] -= p[0] * laws.stiffness[i, j] * q[j]


def rate(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    out[0] += 2.0 * p[0] * qd[1]
    out[1] -= 2.0 * p[0] * qd[0]


def pull(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for i in range(q.size):
        for k in range(u.size):
            out[i] += p[0] * laws.drive[i, k] * u[k]


def curved(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    for i in range(q.size):
        out[i] -= p[0] * (1e13 * q[i] ** 3 + 1e6 * q[i] * u[0] * np.cos(3.0 * t) + 10.0 * qd[i])


def _laws(m: Mechanics) -> Laws:
    return Laws(m.damping[0], m.stiffness[0], m.drive[0], np.zeros((2, 3)), 5.0, 5.0, 3)


def _changed(name: str, m: Mechanics, p: float) -> Mechanics:
    if name == "spring":
        return replace(m, stiffness=m.stiffness * (1.0 + p))
    if name == "pull":
        return replace(m, drive=m.drive * (1.0 + p))
    g = np.zeros((1, 3, 3))
    g[0, 0, 1], g[0, 1, 0] = -2.0 * p, 2.0 * p
    return replace(m, gyroscopic=g)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize(("law", "p"), [(spring, 3e-3), (rate, 2.0), (pull, 0.3)])
@pytest.mark.parametrize("late_s", [0.0, 3.7e-5])
def test_a_linear_force_gives_the_response_of_the_changed_linear_system(
    law: Any, p: float, hold: Any, late_s: float
) -> None:
    m = PLANT.mechanics(VALUES)
    readout = plain_readout(*filter_poles(AntiAlias()), 1, 2)
    clock = SampleClock(1.0 / RATE, hold, 1)
    _, deviation = trajectory(m, [(law, np.array([p]))], _laws(m), DRIVE, clock.step_s, hold, None)
    q, g = upper_poles(readout)
    found = filtered(q, g, readout.static, deviation[:, 3:] @ m.velocity_sense[0].T, clock.step_s, late_s, SUBSTEPS)
    # Reading after the sample equals a negative delay; here it is a positive delay and a shift of the record.
    early = replace(readout, delay_s=clock.step_s - late_s if late_s else 0.0)
    # Each drive has a waveform of its own.
    drive = (np.ascontiguousarray(DRIVE.T), np.eye(2)[None], clock)
    expected = linear_response(_changed(law.__name__, m, p), early, *drive)[0]
    expected = expected - linear_response(m, early, *drive)[0]
    if late_s:
        found, expected = found[:-1], expected[1:]
    assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("start", [None, np.array([1e-4, -2e-4, 0.0, 0.1, 0.2, -0.3])])
def test_the_first_order_response_misses_only_the_second_order(hold: Any, start: FloatArray | None) -> None:
    m = PLANT.mechanics(VALUES)
    reads = np.concatenate([np.zeros((1, 3)), m.velocity_sense[0]], axis=1)
    motion = linear_motion(m, DRIVE, 1.0 / RATE, hold, start, SUBSTEPS)
    linear, _ = trajectory(m, [], _laws(m), DRIVE, 1.0 / RATE, hold, start)
    assert np.max(np.abs(motion.state - linear)) < 1e-12 * np.max(np.abs(linear))
    errors = []
    for p in (1e-4, 1e-5):
        force = [(curved, np.array([p]))]
        whole = trajectory(m, force, _laws(m), DRIVE, 1.0 / RATE, hold, start, reads=reads)[1]
        found = perturbed_motion(motion, m, force, _laws(m), reads)
        errors.append(np.linalg.norm(found - whole) / np.linalg.norm(whole))
    assert errors[0] < 1e-1
    # The error is of the next order.
    assert errors[1] == pytest.approx(0.1 * errors[0], rel=0.05)


def test_the_step_is_fine_enough_and_the_error_of_fourth_order() -> None:
    m = PLANT.mechanics(VALUES)
    force = [(spring, np.array([0.02]))]
    ends = [trajectory(m, force, _laws(m), DRIVE, 1.0 / RATE, "zoh", None, n)[1][::n][-1] for n in (4, 8, 16)]
    coarse, fine = (np.max(np.abs(e - ends[2])[3:] / np.max(np.abs(ends[2][3:]))) for e in ends[:2])
    assert coarse < 1e-6
    # Fourth order.
    assert fine < coarse / 10.0


def test_a_free_motion_decays_from_its_initial_state() -> None:
    m = PLANT.mechanics(VALUES)
    start = np.array([1e-4, -2e-4, 0.0, 0.1, 0.2, -0.3])
    linear, deviation = trajectory(m, [], _laws(m), np.zeros((200, 2)), 1.0 / RATE, "zoh", start)
    t = np.arange(linear.shape[0]) / (4.0 * RATE)
    for i in range(3):
        omega, c = np.sqrt(m.stiffness[0, i, i]), m.damping[0, i, i] / 2.0
        damped = np.sqrt(omega**2 - c**2)
        wave = start[i] * np.cos(damped * t) + (start[3 + i] + c * start[i]) / damped * np.sin(damped * t)
        assert np.max(np.abs(linear[:, i] - np.exp(-c * t) * wave)) < 1e-11 * np.max(np.abs(wave))
    assert not np.any(deviation)


def test_many_forces_act_as_their_sum() -> None:
    m, count = PLANT.mechanics(VALUES), 20
    one = (spring, np.full(1, 1e-4))
    _, many = trajectory(m, [one] * count, _laws(m), DRIVE[:400], 1e-4, "zoh", None)
    _, strong = trajectory(m, [(spring, count * one[1])], _laws(m), DRIVE[:400], 1e-4, "zoh", None)
    assert np.max(np.abs(many - strong)) < 1e-12 * np.max(np.abs(strong))


def refusing(
    t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray
) -> None:
    if t > 1e-2:
        raise ValueError("no law beyond 10 ms")


def test_an_error_that_a_force_raises_ends_the_loop() -> None:
    m = PLANT.mechanics(VALUES)
    with pytest.raises(ValueError, match="no law beyond 10 ms"):
        trajectory(m, [(refusing, np.zeros(1))], _laws(m), DRIVE[:400], 1e-4, "zoh", None)
