"""Pick-offs of acceleration: the record is the time derivative of that of pick-offs of velocity, in every path."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.device.model import Model, PlantSpec
from pipeline.device.operation.state_space import state_space
from pipeline.experiment.forward.harmonic import steady_motion
from pipeline.experiment.forward.harmonic_terms import TonePoints
from pipeline.experiment.forward.record import forward
from pipeline.experiment.forward.system import Conditions, assemble
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

RATE = 20_000.0
SIZES = {"cubic_stiffness.k3": 1e13, "gain_drift.gamma": 1e-3}
NO_RATE = Conditions(0.0, 0.0, None)
VALUES = {"f1_hz": 300.0, "zeta1": 5e-3, "gain1_s1d1": 2.0}
MODE = {"parasitic_mode.f": 410.0, "parasitic_mode.zeta": 4e-3, "parasitic_mode.b_d1": 0.7}


def records(sense: str, effects: tuple[str, ...], values: dict[str, float], hold: str, filtered: bool) -> np.ndarray:
    t = np.arange(4000) / RATE
    drive = np.sin(2.0 * np.pi * (200.0 * t + 1500.0 * t**2))[:, None] * np.hanning(t.size)[:, None]
    model = Model(PlantSpec("modal", 1, sense), effects)
    # The gain of the additional mode is that of w'' / omega, w' or omega w.
    order = {"displacement": 0, "velocity": 1, "acceleration": 2}[sense] - 1
    scaled = {k: v * (2.0 * np.pi * 410.0) ** order if k == "parasitic_mode.b_d1" else v for k, v in values.items()}
    instrument = Instrument(RATE, hold, 5.0, AntiAlias(order=4, corner_hz=8000.0) if filtered else None)
    return forward(model, scaled, Record("r", RATE, drive, np.zeros_like(drive)), instrument)[:, 0]


def derivative(y: np.ndarray) -> np.ndarray:
    """dy/dt to sixth order in the step."""
    near, middle, far = (np.roll(y, -k) - np.roll(y, k) for k in (1, 2, 3))
    return (45.0 * near - 9.0 * middle + far) * RATE / 60.0


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("hold", ["foh", "bandlimited"])
@pytest.mark.parametrize(
    ("effects", "more"),
    [((), {}), (("parasitic_mode",), MODE), (("cubic_stiffness",), {"cubic_stiffness.k3": 1e16})],
    ids=["linear", "two modes", "cubic"],
)
def test_an_acceleration_record_is_the_derivative_of_the_velocity_record(effects, more, hold, filtered) -> None:
    velocity, acceleration = (
        records(sense, effects, {**VALUES, **more}, hold, filtered) for sense in ("velocity", "acceleration")
    )
    inside = slice(200, -200)
    wrong = (acceleration - derivative(velocity))[inside]
    # The corners of a first-order hold are the only part that the difference quotient does not resolve.
    assert np.max(np.abs(wrong)) < 2e-3 * np.max(np.abs(acceleration))
    if effects == ("cubic_stiffness",):
        weak = records("acceleration", (), VALUES, hold, filtered)
        assert np.max(np.abs(acceleration - weak)) > 0.05 * np.max(np.abs(weak))


def test_an_acceleration_follows_a_jump_of_the_force_at_once() -> None:
    t = np.arange(500) / RATE
    drive = np.ones((t.size, 1))
    record = Record("r", RATE, drive, np.zeros_like(drive))
    y = forward(Model(PlantSpec("modal", 1, "acceleration")), VALUES, record, Instrument(RATE))[:, 0]
    w, zeta = 2.0 * np.pi * 300.0, 5e-3
    wd = w * np.sqrt(1.0 - zeta**2)
    # x'' of x'' + 2 zeta w x' + w^2 x = gain after a step of the force.
    exact = 2.0 * np.exp(-zeta * w * t) * (np.cos(wd * t) - zeta / np.sqrt(1.0 - zeta**2) * np.sin(wd * t))
    assert np.max(np.abs(y - exact)) < 1e-11


def test_state_space_of_accelerations_has_a_direct_part() -> None:
    mechanics = Model(PlantSpec("modal", 1, "acceleration")).built.mechanics(VALUES)
    found = state_space(mechanics, RATE)
    s = 2j * np.pi * 250.0
    response = found.C @ np.linalg.solve(s * np.eye(2) - found.A, found.B) + found.D
    w = 2.0 * np.pi * 300.0
    assert response[0, 0] == pytest.approx(2.0 * s**2 / (s**2 + 2.0 * 5e-3 * w * s + w**2), rel=1e-12)


@pytest.mark.parametrize("effects", [(), ("cubic_stiffness",), ("cubic_stiffness", "gain_drift")])
def test_a_sweep_of_acceleration_is_i_omega_times_that_of_velocity(effects) -> None:
    f = np.array([290.0, 299.0, 301.0, 310.0])
    points = TonePoints(f, np.full((f.size, 1), 0.05 + 0.0j), np.arange(f.size) * 1.0)
    tones = []
    for sense in ("velocity", "acceleration"):
        model = Model(PlantSpec("modal", 1, sense), effects)
        values = {**VALUES, **({name: size for name, size in SIZES.items() if name.partition(".")[0] in effects})}
        tones.append(steady_motion(assemble(model, model.complete(values), Instrument(RATE), NO_RATE), points).y[:, 0])
    velocity, acceleration = tones
    assert np.allclose(acceleration, 2.0j * np.pi * f * velocity, rtol=1e-9)
