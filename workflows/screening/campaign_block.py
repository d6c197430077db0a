"""A block of measured campaigns: read, identified and judged like a block of virtual devices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.errors import GyroscreenError
from pipeline.experiment.files.size import check_identification
from pipeline.inference.estimate import reference_comparison
from pipeline.inference.screening.campaign import identify_campaign
from pipeline.inference.screening.result import DeviceResult, failed_result, lost_result
from pipeline.inference.systematic import rate_settings

from ..config import RunConfig
from .block import BlockTables, DeviceBlock, tables_of
from .campaign_source import CampaignSource, declared_id
from .guard import Begin, unguarded
from .judging import judged_devices
from .settings import CAMPAIGN_STREAM, device_seed, settings_of, with_run_tables
from .trimming import trimmed_columns


def _identified(config: RunConfig, source: CampaignSource, n: int) -> tuple[str, DeviceResult]:
    device_id = source.folder.name
    seed = device_seed(config, CAMPAIGN_STREAM, n)
    try:
        campaign = with_run_tables(config, source.read())
        device_id = campaign.device_id
        settings = settings_of(config)
        check_identification(campaign, settings.low_hz, settings.high_hz)
        result = identify_campaign(campaign, settings, config.posterior.settings(), config.judging_gate(), seed)
        compared = reference_comparison(campaign.reference, result.columns)
        if compared:
            text = ", ".join(f"{name} z={r['z']:+.2f}" for name, r in compared.items())
            result = replace(result, columns={**result.columns, "reference": text})
        if config.trim is not None:
            rate = rate_settings(campaign)
            more = trimmed_columns(config.trim, config.judged_by(), result, None, rate, seed.spawn(1)[0])
            result = replace(result, columns={**result.columns, **more})
    except (GyroscreenError, ArithmeticError, ValueError, MemoryError, np.linalg.LinAlgError) as error:
        # One unreadable campaign must not stop the run; its row states the reason.
        result = failed_result(f"{error}")
    return device_id, result


def _stated(campaigns: Sequence[CampaignSource]) -> dict[str, list[str | float | None]]:
    """Who measured each campaign's device, and where it was made, by column; ``None`` where it does not say."""
    conditions, devices = [source.conditions() for source in campaigns], [source.device() for source in campaigns]
    return {
        **{name: [getattr(one, name) or None for one in conditions] for name in ("part", "tester", "session")},
        **{name: [getattr(one, name) or None for one in devices] for name in ("lot", "wafer", "package")},
        **{name: [getattr(one, name) for one in devices] for name in ("die_x_mm", "die_y_mm")},
    }


def campaign_block(
    config: RunConfig, block: DeviceBlock, campaigns: Sequence[CampaignSource], begin: Begin = unguarded
) -> BlockTables:
    """Read, identify and judge ``campaigns``, which are the devices of ``block``; ``begin`` before each."""
    with threadpool_limits(limits=1):
        found = []
        for number, source in enumerate(campaigns, block.first):
            if block.lost:
                found.append((declared_id(source.folder), lost_result(block.lost)))
                continue
            begin(number)
            found.append(_identified(config, source, number))
        return tables_of(
            block.index,
            [device_id for device_id, _ in found],
            _stated(campaigns),
            judged_devices([result for _, result in found], config.judged_by(), config.posterior.stored_draws),
        )
