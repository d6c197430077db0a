"""Parameters: one number of a model, with everything that is needed to fit, test and report it.

A parameter with ``per`` represents a family of parameters, one for each index of the plant:

| per           | members                                | names, for ``k2`` per rocking axis of the gyro |
|---|---|---|
| ""            | one                                    | the name itself |
| "axis"        | one for each coordinate that nonlinear laws act on | k2x, k2y |
| "drive"       | one for each drive                     | <name>_d1, <name>_d2 |
| "path"        | one for each sense and drive, row by row | <name>_s1d1, <name>_s1d2, ... |
| "direction"   | one for each sense but the first       | the name itself, <name>_s3, <name>_s4, ... |

A "direction" is an angle [deg] of a vector of the senses: (cos a, sin a), with a third sense ((cos a, sin a) cos a3, sin a3), and
so on.  The first is defined modulo 180 deg; the others start at 0, where they have no grid.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

from ..errors import ConfigError
from .scale import PAPER, RelativeTo, Scale

Per = Literal["", "axis", "drive", "path", "direction"]

_PRIOR = re.compile(r"^(normal|uniform)\(\s*([^,\s]+)\s*,\s*([^,\s]+)\s*\)$")


@dataclass(frozen=True)
class Shape:
    """Indices of a plant: numbers of senses and drives, suffixes of the axes that nonlinear laws act on, and its scale."""

    senses: int
    drives: int
    axes: tuple[str, ...]
    scale: Scale = PAPER


@dataclass(frozen=True)
class Parameter:
    """One parameter (or family, see the head of the module).

    Parameters
    ----------
    name : symbol, unique within its effect or plant.
    unit : unit of the value; "1" if dimensionless.
    low, high : physical range; a fit stays inside.
    meaning : one line.
    null : the value at which the effect is exactly absent.
    scale : a typical size; steps and searches are made in units of it.
    prior : "uniform" over [low, high], or "normal(mean, sd)".
    per : the index of the plant over which a family runs.
    grid : values to scan, for a parameter that is undefined at the null of its effect (the frequency of a mode, a clip
        level).
    fitted : false if only the values of the grid are possible (mains frequency).
    quantity : name of the result quantity that the parameter is (c12_per_s), or none.
    typical : range within which the nightly bounds of undetected effects look; by default the physical range.
    relative_to : what its numbers are relative to (:mod:`pipeline.device.scale`); they are declared for the gyro of the paper.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    null: float = 0.0
    scale: float = 1.0
    prior: str = "uniform"
    per: Per = ""
    grid: tuple[float, ...] = ()
    fitted: bool = True
    quantity: str = ""
    typical: tuple[float, float] | None = None
    relative_to: RelativeTo = "motion"

    def scaled(self, scale: Scale) -> Parameter:
        """The same parameter of a device with another scale than the gyro of the paper.  A stated prior stays as it is."""
        factor = scale.factor(self.unit, self.relative_to)
        low, high = (self.low * factor, self.high * factor) if self.relative_to != "mode" else scale.modes_hz
        if (factor, low, high) == (1.0, self.low, self.high):
            return self
        return replace(
            self,
            low=low,
            high=high,
            null=self.null * factor,
            scale=self.scale * factor,
            grid=tuple(value * factor for value in self.grid),
            typical=None if self.typical is None else (self.typical[0] * factor, self.typical[1] * factor),
        )

    def members(self, shape: Shape) -> tuple[Parameter, ...]:
        """The members of the family on a plant of ``shape``, relative to its scale."""
        return _members(self, shape)

    def _family(self, shape: Shape) -> tuple[Parameter, ...]:
        if self.per == "axis":
            suffixes = shape.axes
        elif self.per == "drive":
            suffixes = tuple(f"_d{d + 1}" for d in range(shape.drives))
        elif self.per == "path":
            suffixes = tuple(f"_s{s + 1}d{d + 1}" for s in range(shape.senses) for d in range(shape.drives))
        elif self.per == "direction":
            more = (
                replace(self, name=f"{self.name}_s{s + 1}", per="", null=0.0, grid=()) for s in range(2, shape.senses)
            )
            return (self, *more) if shape.senses > 1 else ()
        else:
            return (self,)
        return tuple(replace(self, name=self.name + suffix, per="") for suffix in suffixes)


@lru_cache(maxsize=4096)
def _members(parameter: Parameter, shape: Shape) -> tuple[Parameter, ...]:
    return parameter.scaled(shape.scale)._family(shape)


def read_prior(name: str, text: str) -> tuple[str, float, float]:
    """("normal", mean, sd) or ("uniform", low, high), in the unit of parameter ``name``, from the text of its prior.

    Raises
    ------
    ConfigError : the text has another form, a number is not finite, sd <= 0, or high <= low.
    """
    match = _PRIOR.match(text)
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
