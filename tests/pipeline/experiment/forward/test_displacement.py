"""Displacement pick-offs: the record is the time integral of that of a velocity pick-off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.antialias import filter_poles, filter_response
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

VALUES = {
    "f1_hz": 500.0,
    "f2_hz": 502.0,
    "f3_hz": 560.0,
    "zeta1": 2e-3,
    "zeta2": 2e-3,
    "zeta3": 3e-3,
    "theta_deg": 20.0,
    "rocking_gain": 0.3,
    "updown_gain": 0.5,
    "sense_imbalance": 0.01,
    "drive_imbalance": -0.02,
}


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("effects", [(), ("cubic_stiffness",)])
def test_a_displacement_record_is_the_integral_of_the_velocity_record(filtered, effects):
    rate = 100_000.0
    t = np.arange(20_000) / rate
    drive = np.stack([np.sin(2 * np.pi * (450.0 * t + 500.0 * t**2)), np.sin(2 * np.pi * 520.0 * t)], axis=1)
    antialias = AntiAlias(corner_hz=20_000.0) if filtered else None
    instrument = Instrument(rate, "zoh", 5.0, antialias)
    model = Model(PlantSpec("gyro"), effects).with_channels(2, 2)
    values = {**VALUES, **({"cubic_stiffness.k3": 1e9} if effects else {})}
    record = Record("r", rate, drive, np.zeros_like(drive))
    velocity = forward(model, values, record, instrument)
    displacement = forward(model, values, record, instrument.with_pickoff("displacement"))
    # Simpson's rule over pairs of samples, at 200 samples a period.
    thirds = (velocity[:-2:2] + 4.0 * velocity[1:-1:2] + velocity[2::2]) / (3.0 * rate)
    integral = np.concatenate([np.zeros((1, 2)), np.cumsum(thirds, axis=0)])
    assert np.max(np.abs(displacement[::2][: len(integral)] - integral)) < 1e-5 * np.max(np.abs(integral))


def test_partial_fractions_of_an_integrating_filter_give_its_response():
    for order in (0, 3, 8):
        filter_ = AntiAlias(order=order, corner_hz=3000.0, integrates=True)
        q, r = filter_poles(filter_)
        s = 2j * np.pi * np.array([20.0, 700.0, 5000.0])
        assert np.sum(r / (s[:, None] - q), axis=1) == pytest.approx(filter_response(filter_, s), rel=1e-9)
        plain = replace(filter_, integrates=False)
        assert filter_response(filter_, s) == pytest.approx(filter_response(plain, s) / s, rel=1e-12)


def test_a_pickoff_is_changed_and_changed_back():
    for antialias in (None, AntiAlias(order=4)):
        instrument = Instrument(10_000.0, antialias=antialias)
        assert instrument.pickoff == "velocity"
        turned = instrument.with_pickoff("displacement")
        assert turned.pickoff == "displacement"
        assert turned.with_pickoff("velocity") == instrument
