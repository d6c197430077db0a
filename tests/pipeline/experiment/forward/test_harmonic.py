"""Sweeps by harmonic balance: equal to time integration, with hysteresis; derivatives on the branch; the linear limit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.device.model import Model
from pipeline.device.plant import PlantSpec
from pipeline.errors import ConfigError
from pipeline.experiment.forward.harmonic import branch, steady_motion
from pipeline.experiment.forward.harmonic_terms import TonePoints
from pipeline.experiment.forward.system import Conditions, assemble
from pipeline.experiment.forward.tones import linear_tones
from pipeline.experiment.instrument import Instrument

PLANT = PlantSpec(kind="modal", modes=1)
F0, ZETA, GAIN, DRIVE, K3 = 100.0, 1.5e-2, 50.0, 0.05, 1.5e12
W0 = 2.0 * math.pi * F0


def system(effects=("cubic_stiffness",), **changed):
    model = Model(PLANT, effects=effects)
    values = {"f1_hz": F0, "zeta1": ZETA, "gain1_s1d1": GAIN, "cubic_stiffness.k3": K3} | changed
    known = {name: value for name, value in values.items() if name in model.by_name}
    return assemble(model, model.complete(known), Instrument(1.0), Conditions(0.0, 0.0, None))


def points(f):
    return TonePoints(f, np.full((f.size, 1), DRIVE + 0j), np.arange(f.size) * 1.0)


def integrated(f):
    """X + i Y of the velocity by DOP853, each row from the state that the row before left."""
    state, found = [0.0, 0.0], []
    for own in f:
        w, period = 2.0 * math.pi * own, 1.0 / own

        def slope(t, z, w=w):
            x = z[0]
            return z[1], GAIN * DRIVE * math.cos(w * t) - 2.0 * ZETA * W0 * z[1] - W0**2 * x - K3 * x * x * x

        cycles = int(14.0 / (ZETA * W0) / period) + 1
        t = (cycles + np.arange(16) / 16) * period
        end = (cycles + 1) * period
        run = solve_ivp(slope, (0.0, end), state, "DOP853", rtol=1e-6, atol=1e-12, t_eval=[*t, end])
        state = run.y[:, -1]
        found.append(np.mean(2.0 * run.y[1, :16] * np.exp(-1j * w * t)))
    return np.array(found)


def test_a_duffing_sweep_jumps_as_time_integration_does():
    f = np.array([101.0, 104.0, 105.5, 108.0, 105.5, 101.5])
    y = steady_motion(system(), points(f)).y[:, 0]
    other = integrated(f)
    assert np.abs(y - other).max() < 1e-4 * np.abs(other).max()
    # The upper branch on the way up, the lower one on the way down.
    assert abs(y[2]) > 3.0 * abs(y[4])


def test_an_effect_with_a_memory_is_refused_for_sweeps():
    """Three harmonics give the corners of a hysteresis to 0.3 % of the peak only; 1e-4 is promised."""
    own = system(effects=("hysteresis",), **{"hysteresis.k": 2e4, "hysteresis.r": 3e-5})
    with pytest.raises(ConfigError, match="a memory is not computed for sweeps"):
        steady_motion(own, points(np.array([99.0, 101.0])))


def test_without_forces_the_motion_is_that_of_the_linear_path():
    f = np.linspace(95.0, 105.0, 7)
    linear = system(effects=())
    assert np.allclose(steady_motion(linear, points(f)).y, linear_tones(linear, f, points(f).drive_v), rtol=1e-12)
    # A force that vanishes in the limit of small motion.
    weak = system(**{"cubic_stiffness.k3": 1e-6 * K3})
    small = TonePoints(f, np.full((f.size, 1), 1e-3 * DRIVE + 0j), np.zeros(f.size))
    assert np.allclose(steady_motion(weak, small).y, linear_tones(linear, f, small.drive_v), rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "at", "step"), [("cubic_stiffness.k3", K3, 1e6), ("f1_hz", F0, 1e-4), ("zeta1", ZETA, 1e-7)]
)
def test_derivatives_on_the_branch_are_those_of_the_followed_motion(name, at, step):
    f = np.array([97.0, 101.0, 105.0, 108.0, 104.0, 99.0])
    near = branch(steady_motion(system(), points(f)))
    ends = [system(**{name: at + side * step}) for side in (1.0, -1.0)]
    first = near(ends[0]) - near(ends[1])
    followed = steady_motion(ends[0], points(f)).y - steady_motion(ends[1], points(f)).y
    assert np.abs(first - followed).max() < 1e-4 * np.abs(followed).max()
