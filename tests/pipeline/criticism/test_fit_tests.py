"""Tests of a larger fit on held-out data."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.criticism.held_out import paired_difference
from pipeline.criticism.problem import ResidualBlock


def test_the_sd_of_the_paired_difference_is_its_scatter_in_repetitions() -> None:
    rng = np.random.default_rng(9)
    change = 0.1 * np.sin(np.arange(5000) / 40.0)[:, None]

    def pair(level: float) -> tuple[ResidualBlock, ResidualBlock]:
        noise: FloatArray = level * rng.standard_normal((5000, 1))
        return ResidualBlock("before", noise + change), ResidualBlock("after", noise)

    for level in (1.0, 1.5):
        differences = [paired_difference([a], [b]) for a, b in (pair(level) for _ in range(400))]
        spread = np.std([one.delta_chi2 for one in differences])
        # The sd of 400 draws is uncertain by 3.5 %; the floor of the sd may only widen it.
        assert np.mean([one.sd for one in differences]) == pytest.approx(spread, rel=0.15)
