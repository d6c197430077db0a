"""A problem whose forces and pick-off laws add what they did at one point, and its slopes.

    y(x) = linear(x) + r(x0) + sum_i dr/dx_i (x_i - x0_i)                i over the parameters of those laws

Where their remainder r is weak, a descent gets nearly all the way with it, without the integrator in any step.

Shapes: R records, N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..arrays import FloatArray
from ..experiment.response import Starts, converted, linear_volts, remainder_volts
from ..experiment.sensitivity import Bent, bent_columns, is_gridded
from .campaign_problem import Problem, Task, Tasks


class Frozen(Problem):
    """``whole`` as seen from ``values``, with initial states ``starts`` of the records."""

    def __init__(
        self, whole: Problem, values: Mapping[str, float], tasks: Tasks, starts: Starts, steps: FloatArray
    ) -> None:
        self.threads, self.model, self.sigma_v = whole.threads, whole.model, whole.sigma_v
        self.instrument, self.angular_gain = whole.instrument, whole.angular_gain
        self._x0, self._steps = self.model.to_internal(values), steps
        places_of = [i for i, name in enumerate(self.model.free) if is_gridded(self.model, name)]
        remainders, bent = [], []
        for places, play in tasks.plays:
            own = [starts[i] for i in places]
            remainders.append(remainder_volts(self.system(values, play), play, own))
            bent.append(bent_columns(self.model, values, play, self.instrument, steps, places_of, own))
        self._remainders, self._bent = remainders, bent

    def predictions(self, values: Mapping[str, float], tasks: Tasks, starts: Starts) -> list[FloatArray]:
        """See ``Problem``."""
        moved = self.model.to_internal(values) - self._x0
        out: list[FloatArray] = [np.zeros(0)] * len(tasks.each)
        for (places, play), remainder, bent in zip(tasks.plays, self._remainders, self._bent):
            system = self.system(values, play)
            y = linear_volts(system, play, [starts[i] for i in places]) + remainder
            for i, column in bent.items():
                y += moved[i] * column
            for place, record in zip(places, converted(system, y)):
                out[place] = record
        return out

    def columns(
        self,
        values: Mapping[str, float],
        tasks: Tasks,
        starts: Starts,
        exact: bool,
        steps: FloatArray,
        bent: Sequence[Bent] | None = None,
    ) -> list[FloatArray]:
        """See ``Problem``."""
        return super().columns(values, tasks, starts, False, steps, self._bent if bent is None else bent)

    def steps(self, values: Mapping[str, float], task: Task, start: FloatArray | None) -> FloatArray:
        """See ``Problem``."""
        return self._steps

    def strength(self, values: Mapping[str, float], task: Task) -> float:
        """None that a descent could follow."""
        return 0.0
