"""gyroscreen attribute."""

from __future__ import annotations

import json as json_
from dataclasses import asdict
from pathlib import Path

from pipeline.errors import UsageError, printable_lines
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.read import find_run
from reports.attribution.content import to_plain
from reports.words.attribution import attribution_lines, what_if_lines

from ..attribution.shares import attribution
from ..attribution.what_if import what_if
from ..screening.outcome import config_of_stored


def attribute(run: str | None, results: Path, changes: str | None, samples: int, json: bool) -> None:
    """See ``gyroscreen attribute --help``."""
    folder = find_run(results, run)
    if samples < 2:
        raise UsageError("too few --samples", value=samples, allowed="2 or more", next_step="raise --samples")

    def found(tables: StoredRun) -> tuple[dict[str, object], list[str]]:
        config = config_of_stored(results, tables)
        if not tables.devices.num_rows:
            raise UsageError("the run has no devices", value=folder.name, next_step="name another run, or resume it")
        if changes is not None:
            changed = what_if(config, folder, tables.devices, changes)
            return asdict(changed), what_if_lines(changed)
        shares = attribution(config, folder, tables.devices, samples)
        return asdict(shares), attribution_lines(shares)

    data, lines = with_run(results, folder.name.removeprefix("run="), found)
    print(json_.dumps(to_plain(data)) if json else printable_lines("\n".join(lines)))
