"""The rows of a record are a unitary transform of it, and every row has one noise stratum."""

import numpy as np
import pytest

from pipeline.experiment.record import Record
from pipeline.learning.campaign.rows import spectra_of, strata_of

RATE = 10_000.0
TOP_HZ = RATE / 4.0


def record(samples: int, rate: float = RATE) -> Record:
    return Record("r", rate, np.zeros((samples, 2)), np.zeros((samples, 2)), role="fit")


def test_rows_keep_the_energy_of_a_record_without_its_offset() -> None:
    y = np.random.default_rng(1).standard_normal((3, 999, 2)) + 5.0
    rows = spectra_of(record(999), RATE / 2.0)(y)
    assert rows.shape == (3, 2 * 499, 2)
    expected = np.sum((y - y.mean(axis=1, keepdims=True)) ** 2, axis=(1, 2))
    assert np.sum(rows**2, axis=(1, 2)) == pytest.approx(expected, rel=1e-12)


def test_rows_end_at_the_upper_frequency() -> None:
    t = np.arange(4000)[:, None] / RATE
    spectra = spectra_of(record(4000), TOP_HZ)
    assert spectra.frequency_hz[-1] == TOP_HZ
    beyond = np.sin(2.0 * np.pi * (TOP_HZ + RATE / 4000) * t) * np.ones(2)
    assert np.abs(spectra(beyond)).max() < 1e-9


def test_columns_of_a_jacobian_are_transformed_like_records() -> None:
    spectra = spectra_of(record(400), TOP_HZ)
    y = np.random.default_rng(2).standard_normal((3, 400, 2))
    assert np.array_equal(spectra.columns(y.reshape(3, -1).T, 2), spectra(y).reshape(3, -1).T)


def test_a_stratum_holds_the_rows_of_one_band_and_channel() -> None:
    spectra = spectra_of(record(4000), TOP_HZ)
    strata = strata_of(spectra, 2).reshape(2, spectra.bins.size, 2)
    assert np.array_equal(strata[0], strata[1])
    assert not set(strata[..., 0].ravel()) & set(strata[..., 1].ravel())
    assert np.all(np.diff(strata[0, :, 0]) >= 0)
    assert set(strata.ravel()) == set(range(6))
