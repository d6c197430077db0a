"""A likelihood that raises reaches the caller as its exception alone: emcee prints nothing of its own."""

import numpy as np
import pytest

from pipeline.inference.screening.sample import _ensemble_chains


def test_a_likelihood_that_raises_prints_no_traceback(capfd):
    def density(points):
        raise FloatingPointError("a defect")

    with pytest.raises(FloatingPointError, match="a defect"):
        _ensemble_chains(density, np.eye(8, 2)[None], np.zeros((1, 8)), 3, slice(None), np.random.SeedSequence(1))
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""
