"""Which devices the shipped limits are for: gyros whose rocking modes lie in the band of the shipped run."""

from __future__ import annotations

from dataclasses import replace

from pipeline.experiment.record import Campaign
from pipeline.inference.general.fit import CampaignFit
from pipeline.inference.identify import in_driven_band
from pipeline.inference.screening.device import IdentificationSettings
from reports.limits import DEFAULT_LIMITS, Limits

from .config_tables import IdentificationTable

_BAND = IdentificationTable()


def shipped_limits(fit: CampaignFit) -> Limits | None:
    """The shipped limits, where both rocking modes of ``fit`` lie in the band; else ``None``."""
    found = [fit.values.get(name, 0.0) for name in ("f1_hz", "f2_hz")]
    return DEFAULT_LIMITS if all(_BAND.low_hz <= f <= _BAND.high_hz for f in found) else None


def shipped_limits_of(campaign: Campaign) -> Limits | None:
    """The shipped limits, where the drives of ``campaign`` lie in the band; else ``None``.

    Raises
    ------
    MeasurementError : no record is driven.
    """
    if not campaign.with_role("fit"):
        campaign = replace(campaign, records=tuple(replace(record, role="fit") for record in campaign.records))
    settings = IdentificationSettings(low_hz=_BAND.low_hz, high_hz=_BAND.high_hz)
    return DEFAULT_LIMITS if in_driven_band(settings, campaign) is settings else None
