"""The effect under test: each of the library, and one in a user's folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from effect_cases import LIBRARY, USERS, example_file

from pipeline.device.effect import Effect, find_effects
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model


@pytest.fixture(scope="session")
def user_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the effect that the how-to shows."""
    folder = tmp_path_factory.mktemp("my-effects")
    (folder / f"{USERS}.py").write_text(example_file(), encoding="utf-8")
    return folder


@pytest.fixture(params=[*LIBRARY, USERS])
def effect(request: pytest.FixtureRequest, user_folder: Path) -> Effect:
    return find_effects((user_folder,))[request.param]


@pytest.fixture
def larger(effect: Effect, user_folder: Path) -> Model:
    """The default model with the effect."""
    if "gyro" not in effect.plants:
        pytest.skip("the effect does not apply to the gyro")
    return replace(DEFAULT_COMPARE_MODEL, effect_folders=(str(user_folder),)).with_effect(effect.name)
