"""Sums of squares without lines, by folding, against the squares of what is left without them."""

import numpy as np
import pytest

from pipeline.experiment.noise.lines import squares_without_lines, without_lines


@pytest.mark.parametrize(
    ("samples", "rate_hz", "line_hz"),
    [
        (30_000, 10_000.0, 60.0),  # 166.67 samples a period
        (30_000, 10_000.0, 50.0),
        (30_000, 10_000.0, None),
        (29_999, 10_000.0, 60.0),  # lines between bins
        (1_000, 600.0, 60.0),  # a harmonic at half the sample rate
        (1_001, 1_001.0, 50.0),  # an odd number of samples
        (10_000, 20_000.0, 50.0),  # more harmonics than are removed
    ],
)
def test_squares_by_folding_are_those_of_what_is_left(samples, rate_hz, line_hz):
    random = np.random.default_rng(samples)
    t = np.arange(samples) / rate_hz
    y = random.standard_normal((samples, 2)) + np.array([1.0, -3.0])
    if line_hz is not None:
        y += sum(np.cos(2.0 * np.pi * h * line_hz * t + h)[:, None] for h in (1, 2, 5, 120))
    expected = np.sum(without_lines(y, rate_hz, line_hz) ** 2, axis=0)
    # Rounding of the squares of y, of which the lines are a part.
    assert squares_without_lines(y, rate_hz, line_hz) == pytest.approx(expected, rel=1e-11)
