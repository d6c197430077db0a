"""Noise of a campaign that depends on the signal: timing jitter or gain noise.

    cov n[k] = sigma^2 I + T o c(t_k) c(t_k)',     c and T of ``screening.dependent_noise``

Shapes: N samples, S senses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...experiment.noise.level import NoiseLevel
from ...experiment.noise.spectrum import white_spectrum
from ...experiment.record import Campaign
from ..screening.dependent_noise import DependentNoise, find_dependent_noise, most_significant
from .fit import CampaignFit


def campaign_dependent_noise(fit: CampaignFit, campaign: Campaign) -> DependentNoise | None:
    """The most significant kind of the fit records; ``None`` where none shows it or the noise level is unknown."""
    noise = fit.noise
    if not noise.known or noise.sigma_v.size != 2:
        return None
    predicted = {record.name: record.predicted_v for record in fit.records}
    found = []
    for record in campaign.with_role("fit"):
        spectrum = noise.spectrum or white_spectrum(noise.sigma_v, record.sample_rate_hz, noise.dof)
        rest = record.sense_v - predicted[record.name]
        found.append(find_dependent_noise(rest - rest.mean(axis=0), predicted[record.name], spectrum, 0.0))
    return most_significant(one for one in found if one is not None)


def with_dependent_noise(noise: NoiseLevel, found: DependentNoise, fit: CampaignFit, campaign: Campaign) -> NoiseLevel:
    """The noise with the covariance of every sample of the driven records, from the predicted records."""
    rates = {record.name: record.sample_rate_hz for record in campaign.records}
    mixing = {}
    for record in fit.records:
        c = found.factor(record.predicted_v, rates[record.name]) / noise.sigma_v
        covariance = np.eye(c.shape[1]) + found.covariance * (c[:, :, None] * c[:, None, :])
        mixing[record.name] = _inverse_root(covariance)
    return replace(noise, mixing=mixing)


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """L^-1 (N, S, S) with L L' = covariance (N, S, S)."""
    return np.linalg.inv(np.linalg.cholesky(covariance))
