"""A model: a plant, the effects on it, fixed values, priors, and the smooth coordinates of a fit.

A parameter of an effect is named "effect.parameter"; c12_per_s has no prefix, because it is a result quantity.
Model files are described in :mod:`pipeline.device.model_toml`.  Shapes: P free parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..errors import ConfigError
from .available import available_effects
from .effect import Effect, find_effects
from .model_toml import ModelFields, model_toml, read_model
from .parameters import Parameter, read_prior
from .plant import C12, Plant, PlantSpec

__all__ = ["DEFAULT_COMPARE_MODEL", "SCREENING_MODEL", "Model", "PlantSpec", "load_model", "mains_effects"]


@dataclass(frozen=True)
class Model:
    """A plant, the effects on it, fixed parameter values and priors.

    Parameters
    ----------
    plant : the plant.
    effects : names in any order; the effects act in the order of the signal path.
    fixed : parameter -> value that a fit does not move.
    prior : parameter -> "normal(mean, sd)" or "uniform(low, high)".
    effect_folders : folders with users' own effects.

    Raises
    ------
    ConfigError : an effect is unknown, named twice or does not apply to the plant; a parameter is unknown.
    """

    plant: PlantSpec = field(default_factory=PlantSpec)
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
        """All available effects by name: those of the package and of ``effect_folders``; modes, several times."""
        return available_effects(self.effect_folders)

    @cached_property
    def built(self) -> Plant:
        """The plant object."""
        return self.plant.build()

    def effect(self, name: str) -> Effect:
        """The effect ``name``.

        Raises
        ------
        ConfigError : there is no such effect, or it does not apply to the plant.
        """
        effect = self.library.get(name)
        if effect is None:
            raise ConfigError("no such effect", value=name, allowed=", ".join(self.library))
        if not self.built.kinds & set(effect.plants):
            raise ConfigError(
                f"the effect does not apply to a plant of kind {self.plant.kind!r}",
                value=name,
                allowed=", ".join(self.candidates()),
            )
        return effect

    def candidates(self, demodulated: bool = False) -> tuple[str, ...]:
        """Absent effects that the plant's records, or ``demodulated`` ones of a lock-in, can show; of several modes, the next."""
        kinds, shape = self.built.kinds, self.built.shape
        apply = [e for e in self.library.values() if kinds & set(e.plants) and e.shows(shape)]
        absent = [e for e in apply if e.name not in self.effects and (demodulated or not e.demodulated)]
        next_mode = {e.origin: e.number for e in sorted(absent, key=lambda e: -e.number) if e.mode is not None}
        return tuple(e.name for e in absent if e.number == next_mode.get(e.origin, e.number))

    def ordered_effects(self) -> tuple[Effect, ...]:
        """The effects of the model, sorted by name, so that the order in which they were added does not matter."""
        return tuple(self.effect(name) for name in sorted(self.effects))

    def parameters(self) -> tuple[tuple[str, Parameter], ...]:
        """All parameters as (name, Parameter): those of the plant, c12_per_s, then effect by effect."""
        found, shape = [(parameter.name, parameter) for parameter in self.built.parameters], self.built.shape
        for effect in self.ordered_effects():
            found += [(effect.full_name(member), member) for member in effect.members(shape)]
        # c12 belongs to the smooth coordinates of the plant, so it must come directly after the plant's parameters.
        return tuple(sorted(found, key=lambda item: (len(item[0].split(".")), item[0] == C12)))

    def parameters_of(self, effect: str) -> frozenset[str]:
        """Full names of the parameters of an effect."""
        found = self.effect(effect)
        return frozenset(found.full_name(member) for member in found.members(self.built.shape))

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names (P) of the parameters that a fit moves, in order."""
        return tuple(name for name, parameter in self.parameters() if parameter.fitted and name not in self.fixed)

    @cached_property
    def by_name(self) -> dict[str, Parameter]:
        """All parameters by name."""
        return dict(self.parameters())

    def complete(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of all parameters: fixed values override ``values``; an effect parameter that is not given is at its null.

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
        """Whether all of ``values`` (from :meth:`complete`) lie within their bounds."""
        limits = ((value, *self.bounds(name)) for name, value in values.items())
        return all(low <= value <= high for value, low, high in limits)

    def bounds(self, name: str) -> tuple[float, float]:
        """(low, high) of a parameter [its declared unit]: its range, narrowed by a uniform prior in the model."""
        parameter = self.by_name[name]
        kind, a, b = self.prior_of(name)
        if kind == "uniform" and name in self.prior:
            return max(parameter.low, a), min(parameter.high, b)
        return parameter.low, parameter.high

    def prior_of(self, name: str) -> tuple[str, float, float]:
        """("normal", mean, sd) or ("uniform", low, high) of a parameter [its declared unit].

        Raises
        ------
        ConfigError : the prior cannot be read.
        """
        parameter = self.by_name[name]
        text = self.prior.get(name, parameter.prior)
        return ("uniform", parameter.low, parameter.high) if text == "uniform" else read_prior(name, str(text))

    def with_effect(self, name: str) -> Model:
        """This model with the effect ``name`` added; unchanged if it has the effect already."""
        return self if name in self.effects else replace(self, effects=(*self.effects, name))

    def without_effect(self, name: str) -> Model:
        """This model without the effect ``name``, its fixed values and its priors.

        Raises
        ------
        ConfigError : the effect is not in the model.
        """
        if name not in self.effects:
            raise ConfigError("effect is not in the model", value=name, allowed=", ".join(self.effects) or "none")
        smaller = replace(self, effects=tuple(e for e in self.effects if e != name), fixed={}, prior={})
        return replace(
            smaller,
            fixed={k: v for k, v in self.fixed.items() if k in smaller.by_name},
            prior={k: v for k, v in self.prior.items() if k in smaller.by_name},
        )

    def with_channels(self, senses: int, drives: int) -> Model:
        """This model for records with ``senses`` sense and ``drives`` drive channels.

        Raises
        ------
        ConfigError : the plant is "gyro" and the channels are not 2 x 2.
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

    @cached_property
    def _plant_names(self) -> tuple[str, ...]:
        names = tuple(parameter.name for parameter in self.built.parameters)
        return (*names, C12) if C12 in self.by_name else names

    @cached_property
    def _smooth(self) -> bool:
        # The smooth coordinates of the plant mix its parameters, so none of these may be fixed.
        return not any(name in self.fixed for name in self._plant_names)

    def to_internal(self, values: Mapping[str, float]) -> FloatArray:
        """Smooth coordinates (P,) of complete ``values`` [declared units], in the order of ``free``; units as in ``Plant``."""
        x = np.array([values[name] for name in self.free])
        if self._smooth:
            n = len(self._plant_names)
            x[:n] = self.built.to_internal(x[:n])
        return x

    def to_values(self, x: FloatArray) -> dict[str, float]:
        """Values [declared units] by name from smooth coordinates ``x`` (P,); ConfigError where one is not finite."""
        return self.complete(dict(zip(self.free, self.declared(x).tolist())))

    def declared(self, x: FloatArray) -> FloatArray:
        """Values (.., P) [declared units] of ``free`` from smooth coordinates ``x`` (.., P)."""
        n = len(self._plant_names) if self._smooth else 0
        return np.concatenate([self.built.to_external(x[..., :n]), x[..., n:]], axis=-1) if n else x

    def steps(self, x: FloatArray) -> FloatArray:
        """Steps (P,) for finite differences at ``x`` (P,), in the units of ``x``; 1e-2 of ``scale`` for effects."""
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

    def values_jacobian(self, x: FloatArray) -> FloatArray:
        """d(free values)/dx (P, P) [unit of value / unit of x] at smooth coordinates ``x`` (P,), by central differences."""
        jacobian = np.eye(x.size)
        if not self._smooth:
            return jacobian
        n = len(self._plant_names)
        step = self.built.steps(x[:n])
        for i in range(n):
            moved = np.zeros(n)
            moved[i] = step[i]
            change = self.built.to_external(x[:n] + moved) - self.built.to_external(x[:n] - moved)
            if "theta_deg" in self._plant_names:
                k = self._plant_names.index("theta_deg")
                change[k] = (change[k] + 90.0) % 180.0 - 90.0
            jacobian[:n, i] = change / (2.0 * step[i])
        return jacobian

    def covariance_of_values(self, x: FloatArray, covariance: FloatArray) -> FloatArray:
        """J cov J^T (P, P) [declared units]: first-order covariance of the free values from that of ``x`` (P, P)."""
        jacobian = self.values_jacobian(x)
        return np.asarray(jacobian @ covariance @ jacobian.T)

    def to_toml(self) -> str:
        """The text of the model file."""
        return model_toml(ModelFields(self.plant, self.effects, self.fixed, self.prior, self.effect_folders))


#: The paper's own model (c12 = 0): compare, diagnose and refine start from it.
DEFAULT_COMPARE_MODEL = Model()
#: The model of the screening run: every effect with a parameter that is a result quantity.
SCREENING_MODEL = Model(effects=tuple(n for n, e in find_effects().items() if any(p.quantity for p in e.parameters)))


def mains_effects() -> dict[str, str]:
    """Effects that explain a mains line in silent records, each with the full name of its mains frequency."""
    return {n: f"{n}.{e.mains_frequency}" for n, e in find_effects().items() if e.mains_frequency}


def load_model(path: str | Path, effect_folders: Iterable[str | Path] = ()) -> Model:
    """The model in the file at ``path``, with more folders of effects.

    Raises
    ------
    ConfigError : the file cannot be read, or does not describe a model.
    """
    found = read_model(Path(path), effect_folders)
    return Model(found.plant, found.effects, found.fixed, found.prior, found.effect_folders)
