"""The triangle of features and data by their Gram matrix is that of QR, and reflections stand in where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.inference.screening import triangle
from pipeline.inference.screening.triangle import FeatureRows, triangle_of

ROWS, FEATURES, SCALE = 400, 12, 0.3


def records(count, seed=1):
    """Records with columns of norms from 1e-3 to 1e3 and data that consist of lines, mostly."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        nuisance = np.linalg.qr(random.normal(size=(ROWS, 6)))[0]
        columns = np.asfortranarray(random.normal(size=(ROWS, FEATURES)) * 10.0 ** np.linspace(-3.0, 3.0, FEATURES))
        data = random.normal(size=(ROWS, 2)) + 1e4 * nuisance @ random.normal(size=(6, 2))
        found.append(FeatureRows(columns, data, nuisance, SCALE))
    return found


def expected(parts):
    """[A, y]' [A, y] by numpy, with the lines projected out."""
    rows = []
    for part in parts:
        both = SCALE * np.concatenate([part.columns, part.data], axis=1)
        rows.append(both - part.nuisance @ (part.nuisance.T @ both))
    whole = np.concatenate(rows)
    return whole.T @ whole


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("loudest", [triangle._LOUDEST, 0.0])
def test_triangle_is_that_of_the_rows_less_their_lines(count, loudest, monkeypatch):
    monkeypatch.setattr(triangle, "_LOUDEST", loudest)  # 0: reflections in every case
    parts = records(count)
    found, gram = triangle_of(parts), expected(parts)
    assert (triangle._by_gram(parts) is None) == (loudest == 0.0)
    np.testing.assert_array_equal(found, np.triu(found))
    size = np.sqrt(gram.diagonal())
    np.testing.assert_allclose(found.T @ found / np.outer(size, size), gram / np.outer(size, size), atol=1e-12)


@pytest.mark.parametrize("apart", [1e-4, 1e-6, 0.0])
def test_columns_that_are_nearly_dependent_are_reflected(apart):
    (part,) = records(1)
    first, other = part.columns[:, 0], np.random.default_rng(3).normal(size=ROWS)
    part.columns[:, -1] = 1e3 * (first + apart * np.linalg.norm(first) / np.linalg.norm(other) * other)
    assert (triangle._by_gram([part]) is None) == (apart < 1e-5)
    found, gram = triangle_of([part]), expected([part])
    size = np.sqrt(gram.diagonal())
    np.testing.assert_allclose(found.T @ found / np.outer(size, size), gram / np.outer(size, size), atol=1e-12)
    # What the last column adds to the first, the others aside, is known by reflections to its own rounding.
    assert abs(found[FEATURES - 1, FEATURES - 1]) == pytest.approx(
        apart * size[0] * 1e3, rel=0.2, abs=1e-12 * size[FEATURES - 1]
    )


def test_data_that_are_all_model_are_reflected():
    (part,) = records(1)
    exact = FeatureRows(part.columns, part.columns[:, :2] * 3.0, part.nuisance, SCALE)
    found = triangle_of([exact])
    # Nothing is left of the data beyond rounding of their size.
    assert np.abs(found[FEATURES:, FEATURES:]).max() < 1e-7 * np.abs(found[:, FEATURES:]).max()
