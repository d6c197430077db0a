"""gyroscreen rare."""

from __future__ import annotations

import json as json_
from pathlib import Path

from pipeline.errors import printable_lines
from reports.words.rare import rare_lines

from ..config import load_config
from ..rare.losses import estimated_losses, with_sampling


def rare(config: Path | None, devices: int | None, seed: int | None, json: bool) -> None:
    """See ``gyroscreen rare --help``."""
    loaded = load_config(config, {} if seed is None else {"seed": seed})
    if devices is not None:
        loaded = with_sampling(loaded, {"devices": devices})
    found = estimated_losses(loaded)
    print(json_.dumps(found.to_dict()) if json else printable_lines("\n".join(rare_lines(found))))
