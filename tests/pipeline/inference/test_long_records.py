"""Long records are treated in parts; the parts of a short one give what it gives as a whole."""

import numpy as np
import pytest

from pipeline.experiment.noise import lines
from pipeline.experiment.noise.long_lines import long_fit
from pipeline.inference.screening import compressed, inband, kept
from pipeline.inference.screening.undetected import scanned
from populations.draw import draw
from workflows.config import load_config
from workflows.screening.settings import population
from workflows.screening.virtual_device import identify_virtual


def test_a_device_is_the_same_in_parts_and_as_a_whole(monkeypatch):
    config = load_config(None, {"seed": 5})
    spec = population(config)
    drawn, gain = draw(spec, 5, 0, 1), float(spec.angular_gain)
    whole = identify_virtual(config, drawn, 0, gain).columns
    for module in (inband, kept, scanned):
        monkeypatch.setattr(module, "SHORT", 1000)
    monkeypatch.setattr(scanned, "_AT_ONCE", 10_000)
    monkeypatch.setattr(compressed, "_WAVES", 1)
    parts = identify_virtual(config, drawn, 0, gain).columns
    assert whole["status"] == parts["status"] == "ok"
    assert whole.keys() == parts.keys()
    for name, value in whole.items():
        if isinstance(value, float):
            assert parts[name] == pytest.approx(value, rel=1e-5, abs=1e-9), name
        else:
            assert parts[name] == value


@pytest.mark.parametrize(("rate", "line_hz"), [(8000.0, 60.0), (3333.3, 60.0), (10_000.0, None)])
def test_lines_of_a_long_record_are_those_of_an_orthonormal_basis(rate, line_hz):
    samples, random = 17_001, np.random.default_rng(1)
    t = np.arange(samples)[:, None] / rate
    y = random.standard_normal((samples, 2)) + 3.0 + 5.0 * t + np.cos(2.0 * np.pi * (line_hz or 7.0) * t)
    for trend in (True, False):
        basis = lines.line_basis(samples, rate, line_hz, trend)
        count = (basis.shape[1] - 1 - trend) // 2
        found = long_fit(y, 2.0 * np.pi * (line_hz or 0.0) / rate, count, trend)
        assert np.abs(found - basis @ (basis.T @ y)).max() < 1e-11 * np.abs(y).max()
