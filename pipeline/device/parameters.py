"""Parameters: one number of a model, with what is needed to fit, test and report it.

A parameter with ``per`` stands for a family, one member an index of the plant it meets:

| per           | members                                | names, for ``k2`` per rocking axis of the gyro |
|---|---|---|
| ""            | one                                    | the name itself |
| "axis"        | one a coordinate that nonlinear laws act on | k2x, k2y |
| "drive"       | one a drive                            | <name>_d1, <name>_d2 |
| "path"        | one a sense and drive, row by row      | <name>_s1d1, <name>_s1d2, ... |
| "direction"   | one where there are several senses     | the name itself |
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Per = Literal["", "axis", "drive", "path", "direction"]


@dataclass(frozen=True)
class Shape:
    """What a family of parameters is spread over: numbers of senses and drives, names of the axes of nonlinear laws."""

    senses: int
    drives: int
    axes: tuple[str, ...]


@dataclass(frozen=True)
class Parameter:
    """One parameter (or family, see the head of the module).

    Parameters
    ----------
    name : symbol, unique within its effect or plant.
    unit : of the value; "1" without dimension.
    low, high : range that makes sense; a fit stays inside.
    meaning : one line.
    null : the value that is exactly no effect.
    scale : a size that matters; the unit of steps and searches.
    prior : "uniform" over [low, high], or "normal(mean, sd)".
    per : what a family is spread over.
    grid : values to scan where the parameter does not exist at the null of its effect (a pole's frequency, a clip
        level).
    fitted : false where the grid is all there is (mains frequency).
    quantity : name of the result quantity it is, if it is one.
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

    def members(self, shape: Shape) -> tuple[Parameter, ...]:
        """The parameters that this family stands for on a plant of ``shape``."""
        if self.per == "axis":
            suffixes = shape.axes
        elif self.per == "drive":
            suffixes = tuple(f"_d{d + 1}" for d in range(shape.drives))
        elif self.per == "path":
            suffixes = tuple(f"_s{s + 1}d{d + 1}" for s in range(shape.senses) for d in range(shape.drives))
        else:
            return (self,) if self.per == "" or shape.senses > 1 else ()
        return tuple(replace(self, name=self.name + suffix, per="") for suffix in suffixes)
