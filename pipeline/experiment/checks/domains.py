"""Test the records of every domain of a campaign before any fit."""

from __future__ import annotations

from ..tones import ToneCampaign
from .check import CheckReport, check, worst_first
from .envelopes import check_envelopes
from .tones import check_tones


def check_all(campaign: ToneCampaign) -> CheckReport:
    """The findings of all domains, worst first."""
    reports = [] if campaign.timed is None else [check(campaign.timed)]
    reports += [check_tones(campaign)] if campaign.records else []
    reports += [check_envelopes(campaign.envelopes)] if campaign.envelopes else []
    findings = tuple(finding for report in reports for finding in report.findings)
    return CheckReport(worst_first(findings), tuple(level for report in reports for level in report.levels))
