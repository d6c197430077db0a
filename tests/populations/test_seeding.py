"""The random streams of a population are those of numpy's seed sequences, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from populations.seeding import generators


@pytest.mark.parametrize("seed", [0, 1, 2048, 2**32 - 1, 2**32, 2**70 + 5, 2**130 + 3, 2**170 + 1])
@pytest.mark.parametrize("name", [0, 7, 2**32 - 1, 2**32 + 9])
def test_generators_are_those_of_numpy(seed, name):
    keys = [0, 1, 2, 199, 2**31, 2**32 - 1]
    for more in ([], [2**32], [2**40 + 3]):
        found = list(generators(seed, name, keys + more))
        assert len(found) == len(keys + more)
        for key, random in zip(keys + more, found):
            own = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(name, key))))
            assert random.bit_generator.state == own.bit_generator.state
            np.testing.assert_array_equal(random.standard_normal(3), own.standard_normal(3))
