"""Model files: TOML in (``Model.to_toml`` writes it).

plant = "gyro"                   # or { kind = "modal", modes = 1, sense = "velocity" | "displacement" }
effects = ["offdiagonal_damping"]
effect_folders = ["my-effects"]  # optional: users' own effects, relative to this file
[fixed]                          # optional: parameter = value
[prior]                          # optional: parameter = "normal(mean, sd)" | "uniform(low, high)"
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..toml_files import read_table
from .model import Model, PlantSpec


def _plant_of(data: Any) -> PlantSpec:
    if data == "gyro":
        return PlantSpec()
    allowed = '"gyro" or { kind = "modal", modes = 1, sense = "velocity" | "displacement" }'
    if not isinstance(data, dict) or data.get("kind") not in ("gyro", "modal"):
        raise ConfigError("plant cannot be read", value=data, allowed=allowed)
    extra = set(data) - {"kind", "modes", "sense", "senses", "drives"}
    if extra:
        raise ConfigError("plant has an unknown key", value=sorted(extra), allowed=allowed)
    if data["kind"] == "gyro":
        return PlantSpec()
    numbers = {key: data.get(key, 1) for key in ("modes", "senses", "drives")}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 64:
            raise ConfigError(f"plant.{key} is not a number of channels or modes", value=value, allowed="1 to 64")
    sense = data.get("sense", "velocity")
    if sense not in ("velocity", "displacement"):
        raise ConfigError("plant.sense cannot be read", value=sense, allowed='"velocity", "displacement"')
    return PlantSpec("modal", numbers["modes"], sense, numbers["senses"], numbers["drives"])


def model_of(data: Mapping[str, Any], folder: Path) -> Model:
    """The model that ``data`` (a parsed model file) says; effect folders are relative to ``folder``.

    Raises
    ------
    ConfigError : a key is unknown, or a value is not what the head of the module says.
    """
    known = {"plant", "effects", "effect_folders", "fixed", "prior"}
    extra = set(data) - known
    if extra:
        raise ConfigError("model file has an unknown key", value=sorted(extra), allowed=", ".join(sorted(known)))
    lists: dict[str, tuple[str, ...]] = {}
    for key in ("effects", "effect_folders"):
        found = data.get(key, [])
        if not isinstance(found, list) or not all(isinstance(item, str) for item in found):
            raise ConfigError(f"{key} is not a list of names", value=found, allowed='["name", ..]')
        lists[key] = tuple(found)
    tables: dict[str, dict[str, Any]] = {}
    for key in ("fixed", "prior"):
        found = data.get(key, {})
        if not isinstance(found, dict):
            raise ConfigError(f"{key} is not a table", value=found, allowed="parameter = value")
        # [fixed.gain_drift] gamma = 0.1 says the same as [fixed] "gain_drift.gamma" = 0.1
        tables[key] = {
            full: value
            for name, item in found.items()
            for full, value in (
                {f"{name}.{k}": v for k, v in item.items()} if isinstance(item, dict) else {name: item}
            ).items()
        }
    folders = tuple(str(folder / name) for name in lists["effect_folders"])
    return Model(_plant_of(data.get("plant", "gyro")), lists["effects"], tables["fixed"], tables["prior"], folders)


def load_model(path: str | Path, effect_folders: Iterable[str | Path] = ()) -> Model:
    """The model file at ``path``, and more folders of effects.

    Raises
    ------
    ConfigError : the file cannot be read or does not say a model.
    """
    path = Path(path)
    otherwise = f"write one: gyroscreen model add EFFECT {path.name}"
    data = read_table(path, "model file", "plant, effects, effect_folders, fixed, prior", otherwise)
    # Folders must be known before the effects are looked up.
    extra = [str(Path(folder).resolve()) for folder in effect_folders]
    if extra and isinstance(data.get("effect_folders", []), list):
        data["effect_folders"] = [*data.get("effect_folders", []), *extra]
    return model_of(data, path.parent)
