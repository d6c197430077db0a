"""Runs and other work of the command line in the process of a test: the same devices, without worker processes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from workflows.screening import batch, outcome
from workflows.screening.guard import unguarded


def in_this_process(patch: pytest.MonkeyPatch) -> None:
    """Runs identify their devices one after the other, and write an empty page; misfits are not examined."""

    @contextmanager
    def cluster(*_: Any, **__: Any) -> Iterator[Any]:
        yield SimpleNamespace()

    def in_turn(_: Any, function: Any, given: Any, items: Any, *__: Any, **___: Any) -> Iterator[Any]:
        return ((item, function(given, item, unguarded)) for item in items)

    patch.setattr(batch, "cluster", cluster)
    patch.setattr(batch, "guarded_in_parallel", in_turn)
    patch.setattr("workflows.screening.lot.run.examine_run", lambda *_: None)
    patch.setattr(outcome, "rendered_report", lambda *_, **__: "<!doctype html>")
