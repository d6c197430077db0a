"""Runs in the process of the test whose devices are rows of given status: no cluster, no physics, no figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.store.schema import devices_table
from workflows.screening import batch, outcome
from workflows.screening.block import BlockTables, DeviceBlock
from workflows.screening.guard import unguarded

CONFIG = "[run]\ndevices = {devices}\nblock = 2\n[diagnosis]\nenabled = false\n"


def stub_block(status: str = "ok", reason: str | None = None) -> Callable[..., BlockTables]:
    """A block whose devices all have ``status``; those with status "ok" pass."""

    def block(source: Any, at: DeviceBlock) -> BlockTables:
        n, verdict = at.count, "pass" if status == "ok" else "undecided"
        names = [f"{at.first + i:06d}" for i in range(n)]
        columns = {"status": [status] * n, "status_reason": [reason] * n, "verdict": [verdict] * n}
        return BlockTables(at.index, devices_table({"device_id": names, **columns}), None, {status: n})

    return block


def stub_runs(patch: pytest.MonkeyPatch, block: Callable[..., BlockTables] | None = None, page: bool = False) -> None:
    """Runs compute ``block`` (default: all ok) one after the other; the page of a run is empty unless ``page``."""

    @contextmanager
    def cluster(*_: Any, **__: Any) -> Iterator[Any]:
        yield SimpleNamespace()

    def in_turn(_: Any, function: Any, given: Any, items: Any, *__: Any, **___: Any) -> Iterator[Any]:
        return ((item, function(given, item, unguarded)) for item in items)

    made = block or stub_block()
    patch.setattr(batch, "cluster", cluster)
    patch.setattr(batch, "guarded_in_parallel", in_turn)
    patch.setattr("workflows.screening.lot.run.guarded_in_parallel", in_turn)
    patch.setattr(batch, "block_task", lambda config, item, _: made((config, item.campaigns), item.block))
    if not page:
        empty_pages(patch)


def empty_pages(patch: pytest.MonkeyPatch) -> None:
    """Runs write an empty page: drawing the figures takes longer than the devices."""
    patch.setattr(outcome, "rendered_report", lambda *_, **__: "<!doctype html>")


def run_arguments(folder: Path, devices: int = 4, text: str = "") -> list[str]:
    """Arguments of a run of ``devices`` below ``folder``; ``text`` is appended to its configuration."""
    config = folder / "fab.toml"
    config.write_text(CONFIG.format(devices=devices) + text, encoding="utf-8")
    return ["run", str(config), "--out", str(folder / "results")]
