"""Structure in the residual is found, and noise is called structured no more often than the p-value says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from pipeline.criticism.goodness import agreement, goodness, partitions
from pipeline.criticism.problem import Candidate, FitResult, Region, ResidualBlock, Signatures, Spectrum, TermParameter
from pipeline.criticism.regions import explained_by_region, region_shares
from pipeline.criticism.scores import baseline

NO_PROBES = Signatures((), ())
ROWS = 1000


def _fit(rng: np.random.Generator, residual: list[np.ndarray], **options: Any) -> FitResult:
    jacobian = [rng.standard_normal((ROWS, 3)) for _ in residual]
    q, _ = np.linalg.qr(np.concatenate(jacobian))
    whole = np.concatenate(residual)
    rest = np.split(whole - q @ (q.T @ whole), len(residual))
    blocks = tuple(
        ResidualBlock(f"r{i}", r[:, None], {"level": str(i % 2)}, "same" if i < 2 else None) for i, r in enumerate(rest)
    )
    return FitResult(True, ("t",), {}, blocks, tuple(jacobian), columns={"t": (2,)}, shifts={"t": (1.0,)}, **options)


def test_noise_is_called_structured_no_more_often_than_the_p_value_says() -> None:
    rng = np.random.default_rng(1)
    p = []
    for _ in range(200):
        fit = _fit(rng, [rng.standard_normal(ROWS) for _ in range(4)])
        p.append(goodness(fit, baseline(fit), NO_PROBES, ()).p_value)
    assert sum(value < 0.05 for value in p) <= stats.binom.ppf(0.999, 200, 0.05)


def test_a_repeatable_residual_is_structure_even_where_chi2_is_as_expected() -> None:
    rng = np.random.default_rng(2)
    same = 0.35 * rng.standard_normal(ROWS)
    noise = [np.sqrt(1.0 - 0.35**2) * rng.standard_normal(ROWS) for _ in range(2)]
    fit = _fit(rng, [noise[0] + same, noise[1] + same])
    found = goodness(fit, baseline(fit), NO_PROBES, ())
    assert found.level == pytest.approx(1.0, abs=0.05)
    assert found.worst is not None
    assert found.worst.test == "repeat"
    assert found.p_value < 0.003


def test_q_is_chi_square_where_the_parts_agree() -> None:
    rng = np.random.default_rng(3)
    q: dict[tuple[str, bool], list[float]] = {}
    for _ in range(200):
        fit = _fit(rng, [rng.standard_normal(ROWS) for _ in range(4)])
        base = baseline(fit)
        for name, parts in partitions(fit).items():
            for columns in (None, (2,)):
                result = agreement(base, name, parts, columns)
                assert result.dof == (len(parts) - 1) * (3 if columns is None else 1)
                q.setdefault((name, columns is None), []).append(float(np.exp(result.log_p)))
    assert len(q) == 4
    for p in q.values():
        assert stats.kstest(p, "uniform").pvalue > 0.001


def test_deviations_from_the_common_size_are_estimated_with_their_sd() -> None:
    rng = np.random.default_rng(4)
    jacobian = [rng.standard_normal((ROWS, 3)) for _ in range(3)]
    deviations = []
    for _ in range(100):
        residual = [rng.standard_normal(ROWS) + shift * j[:, 2] for j, shift in zip(jacobian, (0.5, -0.25, -0.25))]
        blocks = tuple(ResidualBlock(str(i), r[:, None]) for i, r in enumerate(residual))
        fit = FitResult(True, ("t",), {}, blocks, tuple(jacobian), columns={"t": (2,)}, shifts={"t": (1.0,)})
        result = agreement(baseline(fit), "block", partitions(fit)["block"], (2,))
        deviations.append([value for value, _ in result.sizes.values()])
        sd = [spread for _, spread in result.sizes.values()]
    mean = np.mean(deviations, axis=0)
    assert mean == pytest.approx([0.5, -0.25, -0.25], abs=0.03)
    # The common size is fitted too, so a deviation scatters less than a single size, by sqrt(1 - 1/3).
    assert np.std(deviations, axis=0) == pytest.approx(np.array(sd) * np.sqrt(2.0 / 3.0), rel=0.25)


def test_regions_have_their_share_of_the_misfit_and_the_share_that_a_new_model_explains() -> None:
    before = [Region("band", {"hz": i}, 100.0 + 300.0 * (i == 3) + 100.0 * (i == 5), 100.0) for i in range(8)]
    after = [Region("band", {"hz": i}, 100.0 + 30.0 * (i == 3), 100.0) for i in range(8)]
    found = region_shares(before)
    assert [item.labels["hz"] for item in found] == [3, 5]
    assert [item.share for item in found] == pytest.approx([0.75, 0.25])
    assert found[0].error == pytest.approx(2.0)
    assert [gone for _, gone in explained_by_region(before, after)] == pytest.approx([0.9, 1.0])
    assert region_shares(after) == ()


def _spectrum(rng: np.random.Generator, colour: np.ndarray, line: float = 0.0) -> Spectrum:
    chi2 = rng.chisquare(20, 10_000) * colour
    chi2[6000] += line
    return Spectrum(np.arange(10_000.0), chi2, 20)


def test_a_weak_line_is_structure_in_the_pooled_spectrum_and_coloured_noise_is_not() -> None:
    rng = np.random.default_rng(5)
    fit = _fit(rng, [rng.standard_normal(ROWS) for _ in range(2)])
    coloured = 1.0 + 3.0 / (1.0 + (np.arange(10_000) / 1000.0) ** 2)
    p = [goodness(fit, baseline(fit), NO_PROBES, (), [_spectrum(rng, coloured)]).p_value for _ in range(200)]
    assert sum(value < 0.05 for value in p) <= stats.binom.ppf(0.999, 200, 0.05)
    found = goodness(fit, baseline(fit), NO_PROBES, (), [_spectrum(rng, np.ones(10_000), line=80.0)])
    assert found.worst is not None
    assert (found.worst.test, found.worst.where) == ("line", "line at 6000 Hz")
    assert found.p_value < 1e-6


def test_a_family_of_probes_sees_10_sigmas_in_one_direction_and_says_how_much_misfit_they_are() -> None:
    rng, k, found = np.random.default_rng(9), 6, []
    family = Candidate("family", (TermParameter("amplitude"),) * k, (slice(0, k),))
    for snr in (0.0, 10.0):
        shapes, _ = np.linalg.qr(rng.standard_normal((4 * ROWS, k)))
        residual = rng.standard_normal(4 * ROWS) + snr * shapes[:, 0]
        fit = _fit(rng, np.split(residual, 4))
        base, probes = baseline(fit), Signatures((family,), tuple(np.split(shapes, 4)))
        found.append(goodness(fit, base, probes, ()))
    noise, hidden = found
    assert noise.p_value > 0.01
    assert hidden.worst is not None
    assert (hidden.worst.test, hidden.worst.where) == ("probe", "family")
    assert hidden.p_value < 1e-10
    # Noncentral chi2_6: 100 + 0 after its rank is subtracted, sd sqrt(2 (6 + 2 100)).
    assert hidden.explained == pytest.approx(100.0, abs=4.0 * np.sqrt(2.0 * (k + 200.0)))
    assert noise.explained < stats.chi2.ppf(0.999, k) - k
