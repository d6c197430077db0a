"""Who reads a TOML block of the manual: the same code as in a command, on a block that may state a few keys alone."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

from pipeline import toml_files
from pipeline.device.model import load_model
from pipeline.experiment.campaign import CampaignTable
from pipeline.learning.lot.lot_file import LotFile
from populations.spec import load_spec
from reports.limits import load_limits
from workflows.config import load_config


def _campaign(path: Path) -> object:
    """Keys of campaign.toml; records are not read, and one is added where the block names none."""
    text = path.read_text(encoding="utf-8")
    whole = text if "[[record]]" in text else f'{text}\n[[record]]\nfile = "record.csv"\n'
    return toml_files.decode(whole.encode(), CampaignTable, path.name)


def _lot(path: Path) -> object:
    text = path.read_text(encoding="utf-8")
    whole = text if "file =" in text else f'file = "lot.csv"\n{text}'
    return toml_files.decode(whole.encode(), LotFile, path.name)


def _any(path: Path) -> object:
    return tomllib.loads(path.read_text(encoding="utf-8"))


#: Mark ``read as`` -> reader.  "other" is for files of other programs: their syntax alone is checked.
READERS: Mapping[str, Callable[[Path], object]] = {
    "run": load_config,
    "limits": load_limits,
    "population": load_spec,
    "model": load_model,
    "campaign": _campaign,
    "lot": _lot,
    "other": _any,
}
