"""Differences by a parameter stay where the model has a solution."""

import numpy as np
import pytest

from pipeline.errors import ConfigError
from pipeline.inference.tones.steps import slope


@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (2.0, np.inf), (-np.inf, 2.0)])
@pytest.mark.parametrize("low", [-np.inf, 2.0])
def test_a_slope_is_that_of_the_side_that_has_a_solution(limits, low):
    def predict(values):
        if not limits[0] <= values["x"] <= limits[1]:
            raise ConfigError("the motion grows")
        return (np.array([values["x"] ** 2]),)

    (found,) = slope(predict, {"x": 2.0}, "x", 1e-6, low)
    assert found == pytest.approx([4.0], rel=1e-6)


def test_a_slope_without_a_solution_on_any_side_is_an_error():
    def predict(values):
        raise ConfigError("the motion grows")

    with pytest.raises(ConfigError, match="grows"):
        slope(predict, {"x": 2.0}, "x", 1e-6, -np.inf)
