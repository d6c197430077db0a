"""Sums of first-order recursions against a loop over the samples."""

import numpy as np
import pytest

from pipeline.experiment.forward.recursion import in_lanes, recursive

#: Lightly damped, real and integrating, far inside the unit circle, at its centre, and unstable.
Z = np.array([0.999 * np.exp(0.3j), 1.0, 0.2 + 0.1j, 0.0, 1.001 * np.exp(2j)])


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2), (3, 2), (2, 3)])
@pytest.mark.parametrize("samples", [1, 127, 128, 129, 3000])
def test_the_sums_equal_those_of_a_loop(samples, inputs, outputs):
    random = np.random.default_rng(samples)

    def drawn(*shape):
        return random.standard_normal(shape) + 1j * random.standard_normal(shape)

    v, direct = random.standard_normal((samples, inputs)), random.standard_normal((outputs, inputs))
    start, weight = drawn(Z.size, inputs), drawn(outputs, Z.size, inputs)
    state, expected = start, np.empty((samples, outputs))
    for n in range(samples):
        expected[n] = direct @ v[n] + np.einsum("spd,pd->s", weight, state).real
        state = Z[:, None] * state + v[n]
    found = recursive(in_lanes(v), Z, start, weight, direct)
    assert found.shape == expected.shape
    # Each sample rounds sums of the size of the states so far.
    assert np.max(np.abs(found - expected)) < 1e-15 * samples * np.max(np.abs(expected))
