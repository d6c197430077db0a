"""A record without its lines, against the least-squares fit of all of them."""

import numpy as np
import pytest

from pipeline.experiment.noise.lines import fitted_lines, without_lines


@pytest.mark.parametrize(
    ("samples", "rate_hz", "line_hz"),
    [
        (5_000, 10_000.0, 60.0),  # 166.67 samples a period
        (4_990, 9_980.0, 50.0),
        (5_000, 10_000.0, None),
        (4_999, 10_000.0, 60.0),  # lines between bins
        (1_001, 1_001.0, 143.0),  # an odd number of samples
        (10_000, 20_000.0, 50.0),  # more harmonics than are removed
    ],
)
def test_what_is_left_is_orthogonal_to_all_lines(samples, rate_hz, line_hz):
    random = np.random.default_rng(samples)
    t = np.arange(samples) / rate_hz
    y = random.standard_normal((samples, 2)) + np.array([1.0, -3.0])
    if line_hz is not None:
        y += sum(np.cos(2.0 * np.pi * h * line_hz * t + h)[:, None] for h in (1, 2, 5, 120))
    expected = y - fitted_lines(y, rate_hz, line_hz, False)
    assert np.max(np.abs(without_lines(y, rate_hz, line_hz) - expected)) < 1e-11
