"""Models: a plant and effects by name, in TOML and out.

    plant = "gyro"                   # or { kind = "modal", modes = 1, sense = "velocity" | "displacement" }
    effects = ["offdiagonal_damping"]
    effect_folders = ["my-effects"]  # optional: users' own effects, relative to this file
    [fixed]                          # optional: parameter = value
    [prior]                          # optional: parameter = "normal(mean, sd)" | "uniform(low, high)"

A parameter of an effect is called "effect.parameter" (quoted in TOML), but c12_per_s, which is a result quantity.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..errors import ConfigError
from .effect import Effect, find_effects
from .parameters import Parameter
from .plant import C12, GyroPlant, ModalPlant, Plant

_PRIOR = re.compile(r"^(normal|uniform)\(\s*([^,\s]+)\s*,\s*([^,\s]+)\s*\)$")


@dataclass(frozen=True)
class PlantSpec:
    """Which plant: "gyro", or "modal" with its number of modes and kind of pick-off, for ``senses`` x ``drives``."""

    kind: Literal["gyro", "modal"] = "gyro"
    modes: int = 1
    sense: Literal["velocity", "displacement"] = "velocity"
    senses: int = 1
    drives: int = 1

    def build(self) -> Plant:
        """The plant itself."""
        if self.kind == "gyro":
            return GyroPlant()
        return ModalPlant(self.modes, self.sense == "displacement", self.senses, self.drives)


@dataclass(frozen=True)
class Model:
    """A plant, the effects on it, what is fixed and what is known beforehand.

    Parameters
    ----------
    plant : which plant.
    effects : names, in any order; they act in the order of the signal.
    fixed : parameter -> value.
    prior : parameter -> "normal(mean, sd)" or "uniform(low, high)".
    effect_folders : folders of users' own effects.

    Raises
    ------
    ConfigError : an effect is unknown, named twice or makes no sense for the plant; a parameter is unknown.
    """

    plant: PlantSpec = PlantSpec()
    effects: tuple[str, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    prior: Mapping[str, str] = field(default_factory=dict)
    effect_folders: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(set(self.effects)) != len(self.effects):
            raise ConfigError("an effect is named twice", value=list(self.effects))
        for name in self.effects:
            self.effect(name)
        known = {name for name, _ in self.parameters()}
        for name in (*self.fixed, *self.prior):
            if name not in known:
                raise ConfigError("no such parameter in this model", value=name, allowed=", ".join(sorted(known)))
        for name, value in self.fixed.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise ConfigError(f"fixed.{name} is not a finite number", value=value, allowed="a number")
        for name in self.prior:
            self.prior_of(name)

    @cached_property
    def library(self) -> dict[str, Effect]:
        """All effects that this model could name."""
        return find_effects(tuple(Path(folder) for folder in self.effect_folders))

    @cached_property
    def built(self) -> Plant:
        """The plant itself."""
        return self.plant.build()

    def effect(self, name: str) -> Effect:
        """The effect ``name``, if it exists and makes sense for the plant."""
        effect = self.library.get(name)
        if effect is None:
            raise ConfigError("no such effect", value=name, allowed=", ".join(self.library))
        if not self.built.kinds & set(effect.plants):
            raise ConfigError(
                f"effect makes no sense for a plant of kind {self.plant.kind!r}",
                value=name,
                allowed=", ".join(self.candidates()),
            )
        return effect

    def candidates(self) -> tuple[str, ...]:
        """Effects that make sense for the plant and are not in the model."""
        kinds = self.built.kinds
        return tuple(n for n, e in self.library.items() if kinds & set(e.plants) and n not in self.effects)

    def ordered_effects(self) -> tuple[Effect, ...]:
        """The model's effects, sorted by name: their order never depends on how they were added."""
        return tuple(self.effect(name) for name in sorted(self.effects))

    def parameters(self) -> tuple[tuple[str, Parameter], ...]:
        """All parameters (name, Parameter) in a fixed order: the plant's, c12_per_s, then effect by effect."""
        found = [(parameter.name, parameter) for parameter in self.built.parameters]
        for effect in self.ordered_effects():
            found += [(effect.full_name(member), member) for member in effect.members(self.built.shape)]
        # c12 shares the plant's smooth coordinates, so it follows them at once.
        return tuple(sorted(found, key=lambda item: (len(item[0].split(".")), item[0] == C12)))

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that a fit moves, in order."""
        return tuple(name for name, parameter in self.parameters() if parameter.fitted and name not in self.fixed)

    @cached_property
    def by_name(self) -> dict[str, Parameter]:
        """Parameter of each name."""
        return dict(self.parameters())

    def complete(self, values: Mapping[str, float]) -> dict[str, float]:
        """All parameters by name: ``values``, then what is fixed; an absent effect parameter is at its null.

        Raises
        ------
        ConfigError : a name is unknown, a plant parameter is missing, or a value is not finite.
        """
        for name in values:
            if name not in self.by_name:
                raise ConfigError("no such parameter in this model", value=name, allowed=", ".join(self.by_name))
        plant = {parameter.name for parameter in self.built.parameters}
        out: dict[str, float] = {}
        for name, parameter in self.by_name.items():
            if name in plant and name not in values and name not in self.fixed:
                raise ConfigError("a parameter of the plant is missing", value=name, next_step="give its value")
            out[name] = float(self.fixed.get(name, values.get(name, parameter.null)))
            if not math.isfinite(out[name]):
                raise ConfigError(f"parameter {name} is not finite", value=out[name])
        return out

    def allowed(self, values: Mapping[str, float]) -> bool:
        """Whether ``values`` (complete) lie in their ranges."""
        for name, value in values.items():
            low, high = self.bounds(name)
            if not low <= value <= high:
                return False
        return True

    def bounds(self, name: str) -> tuple[float, float]:
        """Range of a parameter, narrowed by a uniform prior."""
        parameter = self.by_name[name]
        kind, a, b = self.prior_of(name)
        if kind == "uniform" and name in self.prior:
            return max(parameter.low, a), min(parameter.high, b)
        return parameter.low, parameter.high

    def prior_of(self, name: str) -> tuple[str, float, float]:
        """("normal", mean, sd) or ("uniform", low, high) of a parameter.

        Raises
        ------
        ConfigError : the prior cannot be read.
        """
        parameter = self.by_name[name]
        text = self.prior.get(name, parameter.prior)
        if text == "uniform":
            return "uniform", parameter.low, parameter.high
        match = _PRIOR.match(str(text))
        try:
            if match is None:
                raise ValueError
            kind, a, b = match[1], float(match[2]), float(match[3])
            if not (math.isfinite(a) and math.isfinite(b)) or (b <= 0.0 if kind == "normal" else b <= a):
                raise ValueError
        except ValueError:
            raise ConfigError(
                f"prior of {name} cannot be read", value=text, allowed='"normal(mean, sd)" or "uniform(low, high)"'
            ) from None
        return kind, a, b

    def with_effect(self, name: str) -> Model:
        """This model and the effect ``name``; unchanged if it is there."""
        return self if name in self.effects else replace(self, effects=(*self.effects, name))

    def without_effect(self, name: str) -> Model:
        """This model less the effect ``name``, its fixed values and priors."""
        if name not in self.effects:
            raise ConfigError("effect is not in the model", value=name, allowed=", ".join(self.effects) or "none")
        smaller = replace(self, effects=tuple(e for e in self.effects if e != name), fixed={}, prior={})
        return replace(
            smaller,
            fixed={k: v for k, v in self.fixed.items() if k in smaller.by_name},
            prior={k: v for k, v in self.prior.items() if k in smaller.by_name},
        )

    def with_channels(self, senses: int, drives: int) -> Model:
        """This model for records of ``senses`` x ``drives`` channels.

        Raises
        ------
        ConfigError : plant "gyro" and not 2 x 2.
        """
        if self.plant.kind == "gyro":
            if (senses, drives) != (2, 2):
                raise ConfigError(
                    'plant "gyro" needs two senses and two drives',
                    value=[senses, drives],
                    next_step='use plant = { kind = "modal", modes = 1, sense = "velocity" }',
                )
            return self
        if (self.plant.senses, self.plant.drives) == (senses, drives):
            return self
        return replace(self, plant=replace(self.plant, senses=senses, drives=drives))

    # Smooth coordinates of the free parameters.

    @cached_property
    def _plant_names(self) -> tuple[str, ...]:
        names = tuple(parameter.name for parameter in self.built.parameters)
        return (*names, C12) if C12 in self.by_name else names

    @cached_property
    def _smooth(self) -> bool:
        """The plant's smooth coordinates mix its parameters, so they serve only where none is fixed."""
        return not any(name in self.fixed for name in self._plant_names)

    def to_internal(self, values: Mapping[str, float]) -> FloatArray:
        """Smooth coordinates (P,) of the free parameters, in the order of ``free``."""
        x = np.array([values[name] for name in self.free])
        if self._smooth:
            n = len(self._plant_names)
            x[:n] = self.built.to_internal(x[:n])
        return x

    def to_values(self, x: FloatArray) -> dict[str, float]:
        """All parameters by name from smooth coordinates (P,)."""
        free = x.copy()
        if self._smooth:
            n = len(self._plant_names)
            free[:n] = self.built.to_external(x[:n])
        return self.complete(dict(zip(self.free, free.tolist())))

    def steps(self, x: FloatArray) -> FloatArray:
        """Steps (P,) for differences in the smooth coordinates."""
        values = self.to_values(x)
        n = len(self._plant_names)
        out = np.array([1e-2 * self.by_name[name].scale for name in self.free])
        if self._smooth:
            out[:n] = self.built.steps(x[:n])
        else:
            for i, name in enumerate(self.free):
                if name in self._plant_names:
                    zeta = values.get(f"zeta{name[1]}", 1.0) if name.endswith("_hz") else 1.0
                    out[i] = 1e-4 * max(abs(values[name]), 1e-6) * zeta
        return out

    def turn(self, x: FloatArray) -> FloatArray:
        """d(values of the free parameters)/dx (P, P) at smooth coordinates ``x``."""
        turn = np.eye(x.size)
        if not self._smooth:
            return turn
        n = len(self._plant_names)
        step = self.built.steps(x[:n])
        for i in range(n):
            moved = np.zeros(n)
            moved[i] = step[i]
            change = self.built.to_external(x[:n] + moved) - self.built.to_external(x[:n] - moved)
            if "theta_deg" in self._plant_names:
                k = self._plant_names.index("theta_deg")
                change[k] = (change[k] + 90.0) % 180.0 - 90.0
            turn[:n, i] = change / (2.0 * step[i])
        return turn

    def covariance_of_values(self, x: FloatArray, covariance: FloatArray) -> FloatArray:
        """Covariance (P, P) of the free parameters from that of the smooth coordinates, to first order."""
        turn = self.turn(x)
        return np.asarray(turn @ covariance @ turn.T)

    def to_toml(self) -> str:
        """The model file."""
        plant = self.plant
        shown = '"gyro"'
        if plant.kind == "modal":
            channels = (
                "" if plant.senses == plant.drives == 1 else f", senses = {plant.senses}, drives = {plant.drives}"
            )
            shown = f'{{ kind = "modal", modes = {plant.modes}, sense = "{plant.sense}"{channels} }}'
        lines = [f"plant = {shown}", f"effects = {_list(self.effects)}"]
        if self.effect_folders:
            lines.append(f"effect_folders = {_list(self.effect_folders)}")
        if self.fixed:
            lines += ["", "[fixed]", *(f"{_key(k)} = {float(v)!r}" for k, v in self.fixed.items())]
        if self.prior:
            lines += ["", "[prior]", *(f"{_key(k)} = {_text(v)}" for k, v in self.prior.items())]
        return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    # JSON strings are TOML basic strings.
    return json.dumps(value, ensure_ascii=False)


def _list(values: Iterable[str]) -> str:
    return "[" + ", ".join(_text(value) for value in values) + "]"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


#: The paper's own model (c12 = 0): where compare, diagnose and refine start.
DEFAULT_COMPARE_MODEL = Model()
#: The screening run's.
SCREENING_MODEL = Model(effects=("offdiagonal_damping",))


def load_model(path: str | Path, effect_folders: Iterable[str | Path] = ()) -> Model:
    """The model file at ``path``, see ``model_file.load_model``."""
    from .model_file import load_model as load

    return load(path, effect_folders)
