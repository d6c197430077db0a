"""Identification of a measured campaign of a gyro, by the same likelihood as a virtual device.

The in-band path needs two drives, two senses, records that start at rest, and hold "zoh" or "foh".
``pipeline.inference.identify`` sends other campaigns through the general fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import MeasurementError
from ...experiment.bad_samples import without_bad_samples
from ...experiment.noise.level import NoiseLevel, noise_level
from ...experiment.noise.lines import hum_line
from ...experiment.noise.spectrum import NoiseSpectrum, white_spectrum
from ...experiment.record import PAPER_FRAME, Campaign
from ..gate import Gate
from ..systematic import rate_settings
from .device import IdentificationSettings, identify_device, prepare
from .result import DeviceResult
from .sample import SamplerSettings


def is_inband(campaign: Campaign) -> bool:
    """Whether the in-band likelihood applies to this campaign."""
    return (
        campaign.frame == PAPER_FRAME
        and campaign.instrument.hold in ("zoh", "foh")
        and all(
            record.drive_v.shape[1] == 2 and record.sense_v.shape[1] == 2 and record.at_rest
            for record in campaign.with_role("fit")
        )
    )


def campaign_noise(campaign: Campaign) -> tuple[NoiseLevel, float | None]:
    """Noise level of each channel (see ``noise_level``), and the mains frequency [Hz] if the silent record shows hum."""
    silent = campaign.with_role("noise")
    line_hz = hum_line(silent[0].sense_v, campaign.instrument.sample_rate_hz) if silent else None
    return noise_level(campaign, line_hz), line_hz


def campaign_spectrum(campaign: Campaign, noise: NoiseLevel) -> NoiseSpectrum:
    """The spectrum of the noise: that of the silence where it has a colour, else white at the level ``noise``."""
    return noise.spectrum or white_spectrum(noise.sigma_v, campaign.instrument.sample_rate_hz, noise.dof)


def identify_campaign(
    campaign: Campaign,
    settings: IdentificationSettings,
    sampler: SamplerSettings,
    gate: Gate,
    seed: np.random.SeedSequence,
) -> DeviceResult:
    """Identify the device of a campaign from its fit records.

    Parameters
    ----------
    campaign : for which :func:`is_inband` holds.
    settings, sampler, gate : see their classes; the mains frequency of ``settings`` is replaced by the measured one.
    seed : random stream of this device.

    Raises
    ------
    MeasurementError : no record to fit, a channel without noise, or too many bad samples.
    """
    campaign = without_bad_samples(campaign)
    fit = campaign.with_role("fit")
    if not fit:
        raise MeasurementError("no record to fit", value=campaign.device_id, allowed='a record with role = "fit"')
    noise, line_hz = campaign_noise(campaign)
    if not np.all(noise.sigma_v > 0.0):
        raise MeasurementError(
            "a sense channel shows no noise",
            value=[float(s) for s in noise.sigma_v],
            allowed="noise above zero in every channel",
            next_step="check the silent record, or declare the converter in [instrument] adc",
        )
    with_hum = replace(settings, line_hz=line_hz)
    prepared = [prepare(record, campaign.instrument, with_hum) for record in fit]
    spectrum = campaign_spectrum(campaign, noise)
    result = identify_device(
        prepared, spectrum, campaign.instrument, with_hum, sampler, gate, rate_settings(campaign), seed
    )
    if noise.independent:
        return result
    # An error in units of a noise level that is estimated from the same driven records would not be independent.
    return replace(result, columns={**result.columns, "error": None, "error_all_noise": None, "chi2_per_dof": None})
