"""What several tests of the workflows share."""

from __future__ import annotations

from dataclasses import replace

import pytest

from workflows.simulate import standard_excitations
from workflows.studies.hidden import draw


@pytest.fixture
def brief_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """The standard campaign with records of 1 s."""
    brief = [(name, role, replace(e, duration_s=1.0)) for name, role, e in standard_excitations(1)]
    monkeypatch.setattr(draw, "standard_excitations", lambda seed: brief)
