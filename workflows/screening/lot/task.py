"""The examination of a device as a task of a worker; a worker needs no more of ``lot`` than this and ``device``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ...config import RunConfig
from ..campaign_source import CampaignSource
from ..faults import Faults
from ..guard import Begin
from .device import DeviceExamination, Request, examine_device, failed_examination


@dataclass(frozen=True)
class ExamineItem:
    """A device to examine, with its campaign if it is measured; ``lost`` says why it was given up."""

    request: Request
    campaigns: Mapping[int, CampaignSource]
    lost: str = ""


def examine_task(config: RunConfig, item: ExamineItem, begin: Begin) -> DeviceExamination:
    """The examination of one device; runs in a worker."""
    if item.lost:
        return failed_examination(item.request, item.lost)
    begin(item.request.number)
    return examine_device((config, item.campaigns), item.request)


EXAMINE_FAULTS: Faults[ExamineItem] = Faults(
    devices=lambda item: range(item.request.number, item.request.number + 1),
    part=lambda item, _: item,
    lost=lambda item, reason: replace(item, lost=reason),
)
