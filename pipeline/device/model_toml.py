"""Model files: TOML text to the fields of a model, and back.

plant = "gyro"                   # or { kind = "modal", modes = 1, sense = "velocity" | "displacement" }
effects = ["offdiagonal_damping"]
effect_folders = ["my-effects"]  # optional: folders with your own effects, relative to this file
[fixed]                          # optional: parameter = value
[prior]                          # optional: parameter = "normal(mean, sd)" | "uniform(low, high)"

A parameter of an effect is named "effect.parameter" (quoted in TOML); c12_per_s has no prefix, because it is a result quantity.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..toml_files import read_table
from .plant import PlantSpec


@dataclass(frozen=True)
class ModelFields:
    """The content of a model file; the fields are those of ``Model``, which also checks the names."""

    plant: PlantSpec
    effects: tuple[str, ...]
    fixed: Mapping[str, Any]
    prior: Mapping[str, Any]
    effect_folders: tuple[str, ...]


def read_model(path: Path, effect_folders: Iterable[str | Path] = ()) -> ModelFields:
    """Read the model file at ``path``; folders in the file are relative to it, ``effect_folders`` to the working directory.

    Raises
    ------
    ConfigError : the file cannot be read, a key is unknown, or a value has the wrong form.
    """
    otherwise = f"write one: gyroscreen model add EFFECT {path.name}"
    data = read_table(path, "model file", "plant, effects, effect_folders, fixed, prior", otherwise)
    extra = [str(Path(folder).resolve()) for folder in effect_folders]
    if extra and isinstance(data.get("effect_folders", []), list):
        data = {**data, "effect_folders": [*data.get("effect_folders", []), *extra]}
    return _fields_of(data, path.parent)


def _fields_of(data: Mapping[str, Any], folder: Path) -> ModelFields:
    known = {"plant", "effects", "effect_folders", "fixed", "prior"}
    extra = set(data) - known
    if extra:
        raise ConfigError("model file has an unknown key", value=sorted(extra), allowed=", ".join(sorted(known)))
    folders = tuple(str(folder / name) for name in _names(data, "effect_folders"))
    plant = _plant_of(data.get("plant", "gyro"))
    return ModelFields(plant, _names(data, "effects"), _table(data, "fixed"), _table(data, "prior"), folders)


def _names(data: Mapping[str, Any], key: str) -> tuple[str, ...]:
    found = data.get(key, [])
    if not isinstance(found, list) or not all(isinstance(item, str) for item in found):
        raise ConfigError(f"{key} is not a list of names", value=found, allowed='["name", ..]')
    return tuple(found)


def _table(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    found = data.get(key, {})
    if not isinstance(found, dict):
        raise ConfigError(f"{key} is not a table", value=found, allowed="parameter = value")
    # [fixed.gain_drift] gamma = 0.1 is the same as [fixed] "gain_drift.gamma" = 0.1
    out: dict[str, Any] = {}
    for name, item in found.items():
        out |= {f"{name}.{k}": v for k, v in item.items()} if isinstance(item, dict) else {name: item}
    return out


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


def model_toml(fields: ModelFields) -> str:
    """The text of a model file with these fields."""
    lines = [f"plant = {_plant_text(fields.plant)}", f"effects = {_list(fields.effects)}"]
    if fields.effect_folders:
        lines.append(f"effect_folders = {_list(fields.effect_folders)}")
    if fields.fixed:
        lines += ["", "[fixed]", *(f"{_key(k)} = {float(v)!r}" for k, v in fields.fixed.items())]
    if fields.prior:
        lines += ["", "[prior]", *(f"{_key(k)} = {_text(v)}" for k, v in fields.prior.items())]
    return "\n".join(lines) + "\n"


def _plant_text(plant: PlantSpec) -> str:
    if plant.kind == "gyro":
        return '"gyro"'
    channels = "" if plant.senses == plant.drives == 1 else f", senses = {plant.senses}, drives = {plant.drives}"
    return f'{{ kind = "modal", modes = {plant.modes}, sense = "{plant.sense}"{channels} }}'


def _text(value: str) -> str:
    # A JSON string is also a TOML basic string.
    return json.dumps(value, ensure_ascii=False)


def _list(values: Iterable[str]) -> str:
    return "[" + ", ".join(_text(value) for value in values) + "]"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)
