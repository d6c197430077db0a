"""Timing jitter in the noise of a campaign: the variance of a sample grows with the squared slope of its record.

    cov n[k] = sigma^2 I + T o S'(t_k) S'(t_k)',     T (S, S) [s^2] from the residual above the signal band (``find_jitter``)

Shapes: N samples, S senses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...experiment.noise.level import NoiseLevel
from ...experiment.noise.source import slope_v_per_s
from ...experiment.noise.spectrum import white_spectrum
from ...experiment.record import Campaign
from ..screening.dependent_noise import Jitter, find_jitter
from .fit import CampaignFit


def campaign_jitter(fit: CampaignFit, campaign: Campaign) -> Jitter | None:
    """The most significant jitter of the fit records; ``None`` where none shows it or the noise level is unknown."""
    noise = fit.noise
    if not noise.known or noise.sigma_v.size != 2:
        return None
    predicted = {record.name: record.predicted_v for record in fit.records}
    found = []
    for record in campaign.with_role("fit"):
        rate = record.sample_rate_hz
        spectrum = noise.spectrum or white_spectrum(noise.sigma_v, rate, noise.dof)
        y = predicted[record.name]
        rest = record.sense_v - y
        jitter = find_jitter(rest - rest.mean(axis=0), slope_v_per_s(y, rate), spectrum, 0.0)
        if jitter is not None:
            found.append(jitter)
    return max(found, key=lambda one: one.significance, default=None)


def with_jitter(noise: NoiseLevel, jitter: Jitter, fit: CampaignFit, campaign: Campaign) -> NoiseLevel:
    """The noise with the covariance of every sample of the driven records, from the predicted slopes."""
    rates = {record.name: record.sample_rate_hz for record in campaign.records}
    mixing = {}
    for record in fit.records:
        s = slope_v_per_s(record.predicted_v, rates[record.name]) / noise.sigma_v
        covariance = np.eye(s.shape[1]) + jitter.covariance_s2 * (s[:, :, None] * s[:, None, :])
        mixing[record.name] = _inverse_root(covariance)
    return replace(noise, mixing=mixing)


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """L^-1 (N, S, S) with L L' = covariance (N, S, S)."""
    return np.linalg.inv(np.linalg.cholesky(covariance))
