"""Model files: TOML text to the fields of a model, and back.

plant = "gyro"                   # or { kind = "modal", modes = 1, sense = "velocity" | "displacement" | "acceleration" }
effects = ["offdiagonal_damping"]
effect_folders = ["my-effects"]  # optional: folders with your own effects, relative to this file
[fixed]                          # optional: parameter = value
[prior]                          # optional: parameter = "normal(mean, sd)" | "uniform(low, high)"

A parameter of an effect is named "effect.parameter" (quoted in TOML); c12_per_s has no prefix, because it is a result quantity.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from msgspec import Meta, Struct

from ..toml_files import load, table
from ..toml_keys import Meaning
from .plant import PlantSpec, Sense

Count = Annotated[int, Meta(ge=1, le=64)]
Value = TypeVar("Value", float, str)


class PlantTable(Struct, frozen=True, forbid_unknown_fields=True):
    """A plant with options."""

    kind: Annotated[
        Literal["gyro", "modal"],
        Meaning("gyro: the eleven parameters of the paper; modal: any number of modes, senses and drives"),
    ]
    modes: Annotated[Count, Meaning("number of modes of a modal plant", "1")] = 1
    sense: Annotated[Sense, Meaning("what the senses of a modal plant measure")] = "velocity"
    senses: Annotated[Count, Meaning("number of senses of a modal plant", "1")] = 1
    drives: Annotated[Count, Meaning("number of drives of a modal plant", "1")] = 1

    def built(self) -> PlantSpec:
        """The plant that this table describes."""
        if self.kind == "gyro":
            return PlantSpec()
        return PlantSpec("modal", self.modes, self.sense, self.senses, self.drives)


class ModelTable(Struct, frozen=True, forbid_unknown_fields=True):
    """A model file.  ``[fixed.gain_drift] gamma = 0.1`` means the same as ``[fixed] "gain_drift.gamma" = 0.1``."""

    plant: Annotated[
        Literal["gyro"] | PlantTable, Meaning('rigid-body model: "gyro", or a table for a modal plant')
    ] = "gyro"
    effects: Annotated[tuple[str, ...], Meaning("effects of the model, by name")] = ()
    effect_folders: Annotated[
        tuple[str, ...], Meaning("folders with your own effects, relative to the model file")
    ] = ()
    fixed: Annotated[
        dict[str, float | dict[str, float]],
        Meaning('parameter = value: parameters that are not fitted, as "effect.parameter"', "that of the parameter"),
    ] = {}
    prior: Annotated[
        dict[str, str | dict[str, str]],
        Meaning(
            'parameter = "normal(mean, sd)" or "uniform(low, high)", in place of the declared prior',
            "that of the parameter",
        ),
    ] = {}


@dataclass(frozen=True)
class ModelFields:
    """The content of a model file; the fields are those of ``Model``, which also checks the names."""

    plant: PlantSpec
    effects: tuple[str, ...]
    fixed: Mapping[str, float]
    prior: Mapping[str, str]
    effect_folders: tuple[str, ...]


def read_model(path: Path, effect_folders: Iterable[str | Path] = ()) -> ModelFields:
    """Read the model file at ``path``; folders in the file are relative to it, ``effect_folders`` to the working directory.

    Raises
    ------
    ConfigError : the file cannot be read, a key is unknown, or a value has the wrong form.
    """
    found = load(path, ModelTable, "model file", f"write one: gyroscreen model add EFFECT {path.name}")
    plant = found.plant.built() if isinstance(found.plant, PlantTable) else PlantSpec()
    folders = (*found.effect_folders, *(str(Path(folder).resolve()) for folder in effect_folders))
    absolute = tuple(str(path.parent / folder) for folder in folders)
    return ModelFields(plant, found.effects, _full_names(found.fixed), _full_names(found.prior), absolute)


def _full_names(values: Mapping[str, Value | dict[str, Value]]) -> dict[str, Value]:
    """Values by the full name "effect.parameter"."""
    out: dict[str, Value] = {}
    for name, item in values.items():
        out |= {f"{name}.{k}": v for k, v in item.items()} if isinstance(item, dict) else {name: item}
    return out


def model_toml(fields: ModelFields) -> str:
    """The text of a model file with these fields."""
    top = {
        "plant": _plant_value(fields.plant),
        "effects": fields.effects,
        "effect_folders": fields.effect_folders or None,
    }
    fixed = {name: float(value) for name, value in fields.fixed.items()}
    parts = (table("", top), table("[fixed]", fixed), table("[prior]", dict(fields.prior)))
    return "\n".join(part for part in parts if part)


def _plant_value(plant: PlantSpec) -> str | dict[str, Any]:
    if plant.kind == "gyro":
        return "gyro"
    channels = {} if plant.senses == plant.drives == 1 else {"senses": plant.senses, "drives": plant.drives}
    return {"kind": "modal", "modes": plant.modes, "sense": plant.sense, **channels}
