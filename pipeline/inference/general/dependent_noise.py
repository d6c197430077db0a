"""Noise of a campaign that depends on the signal: timing jitter or gain noise.

    cov n[k] = sigma^2 I + T o c(t_k) c(t_k)',     c and T of ``screening.dependent_noise``

A record that was advanced by its start time has interpolated noise, so its shift is needed.

Shapes: N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ...arrays import FloatArray
from ...experiment.noise.level import NoiseLevel
from ...experiment.noise.spectrum import white_spectrum
from ...experiment.record import Campaign
from ..screening.dependent_noise import DependentNoise, advanced_products, find_dependent_noise, pooled
from .fit import CampaignFit

NO_STARTS: Mapping[str, float] = MappingProxyType({})


def campaign_dependent_noise(
    fit: CampaignFit, campaign: Campaign, starts_s: Mapping[str, float] = NO_STARTS
) -> DependentNoise | None:
    """The most significant kind, pooled over the fit records; ``None`` where none shows it or the noise level is unknown.

    ``starts_s`` [s] by record is the time by which it was advanced.
    """
    noise = fit.noise
    if not noise.known:
        return None
    predicted = {record.name: record.predicted_v for record in fit.records}
    found = []
    for record in campaign.with_role("fit"):
        spectrum = noise.spectrum or white_spectrum(noise.sigma_v, record.sample_rate_hz, noise.dof)
        rest = record.sense_v - predicted[record.name]
        shift = starts_s.get(record.name, 0.0) * record.sample_rate_hz
        own = predicted[record.name]
        found.append(find_dependent_noise(rest - rest.mean(axis=0), own, spectrum, 0.0, shift, record.at_rest))
    return pooled(one for one in found if one is not None)


def with_dependent_noise(
    noise: NoiseLevel,
    found: DependentNoise,
    fit: CampaignFit,
    campaign: Campaign,
    starts_s: Mapping[str, float] = NO_STARTS,
) -> NoiseLevel:
    """The noise with the covariance of every sample of the driven records, from the predicted records.

    ``starts_s`` [s] by record is the time by which it was advanced.
    """
    rates = {record.name: record.sample_rate_hz for record in campaign.records}
    mixing = {}
    for record in fit.records:
        c = found.factor(record.predicted_v, rates[record.name]).T / noise.sigma_v[:, None]
        shift = starts_s.get(record.name, 0.0) * rates[record.name]
        products = np.moveaxis(advanced_products(c[:, None] * c[None, :], shift), -1, 0)
        covariance = np.eye(c.shape[0]) + found.covariance * products
        mixing[record.name] = _inverse_root(covariance)
    return replace(noise, mixing=mixing)


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """L^-1 (N, S, S) with L L' = covariance (N, S, S)."""
    return np.linalg.inv(np.linalg.cholesky(covariance))
