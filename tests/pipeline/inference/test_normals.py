"""Normals of the sampler follow the normal distribution, in the layers, in their wedges and in the tail."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom, chi2, kstest, norm

from pipeline.inference.screening.normals import _EDGE, standard_normals

COUNT = 4_000_000


def test_normals_are_distributed_as_they_should():
    drawn = standard_normals((4, COUNT // 4), np.random.Generator(np.random.SFC64(11)))
    assert drawn.shape == (4, COUNT // 4)
    x = drawn.ravel()
    # Every edge of a layer is an edge of a bin, so that a wrong share of a layer, of its wedge or of the tail shows.
    inner = np.linspace(0.0, 1.0, 5)[:-1]
    fine = (_EDGE[1:-1, None] * (1.0 - inner) + _EDGE[2:, None] * inner).ravel()
    edges = np.unique(np.concatenate([-fine, [0.0], fine]))
    edges = edges[np.diff(edges, prepend=-np.inf) > 1e-12]
    expected = np.diff(norm.cdf(edges), prepend=0.0, append=1.0) * COUNT
    found = np.bincount(np.searchsorted(edges, x), minlength=edges.size + 1)
    statistic = np.sum((found - expected) ** 2 / expected)
    assert chi2.sf(statistic, edges.size) > 1e-4
    assert chi2.cdf(statistic, edges.size) > 1e-4
    assert kstest(x, "norm").pvalue > 1e-4


def test_the_tail_is_that_of_a_normal():
    x = np.abs(standard_normals((COUNT,), np.random.Generator(np.random.SFC64(12))))
    for level in (3.6541528853610088, 4.0, 4.5, 5.0):
        low, high = binom.interval(1.0 - 1e-4, COUNT, 2.0 * norm.sf(level))
        assert low <= np.count_nonzero(x > level) <= high


def test_normals_are_independent_of_their_neighbours():
    x = standard_normals((COUNT,), np.random.Generator(np.random.SFC64(13)))
    for lag in (1, 2, 3):
        assert abs(np.mean(x[lag:] * x[:-lag])) < 4.0 / np.sqrt(COUNT)
        assert abs(np.mean((x[lag:] ** 2 - 1.0) * (x[:-lag] ** 2 - 1.0))) < 4.0 * 2.0 / np.sqrt(COUNT)
