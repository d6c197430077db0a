"""A problem whose forces and pick-off laws add what they did at one point, and its slopes.

    y(x) = linear(x) + r(x0) + sum_i dr/dx_i (x_i - x0_i)                i over the parameters of those laws

Where their remainder r is weak, a descent gets nearly all the way with it, without the integrator in any step.

Shapes: R records, N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Mapping

from ...arrays import FloatArray
from ...experiment.forward.drive_groups import DriveGroup
from ...experiment.forward.response import Starts, linear_volts, nonlinear_response
from ...experiment.forward.sensitivity import NonlinearColumns, is_integrated, nonlinear_columns
from ...experiment.forward.system import System
from .residuals import CampaignResiduals, Task, Tasks


class LinearizedResiduals(CampaignResiduals):
    """``whole`` as seen from ``values``, with initial states ``starts`` of the records."""

    def __init__(
        self, whole: CampaignResiduals, values: Mapping[str, float], tasks: Tasks, starts: Starts, steps: FloatArray
    ) -> None:
        self.threads, self.model, self.sigma_v = whole.threads, whole.model, whole.sigma_v
        self.instrument, self.angular_gain = whole.instrument, whole.angular_gain
        self._x0 = self.model.to_internal(values)
        own = [i for i, name in enumerate(self.model.free) if is_integrated(self.model, name)]
        self._remainders: list[FloatArray] = []
        self._slopes: list[NonlinearColumns] = []
        for places, group in tasks.groups:
            begun = [starts[i] for i in places]
            self._remainders.append(nonlinear_response(self.system(values, group), group, begun))
            self._slopes.append(nonlinear_columns(self.model, values, group, self.instrument, steps, own, begun))

    def _volts(
        self, number: int, values: Mapping[str, float], system: System, group: DriveGroup, starts: Starts
    ) -> FloatArray:
        moved = self.model.to_internal(values) - self._x0
        y = linear_volts(system, group, starts) + self._remainders[number]
        for i, column in self._slopes[number].items():
            y += moved[i] * column
        return y

    def _nonlinear_columns(self, number: int) -> NonlinearColumns:
        return self._slopes[number]

    def strength(self, values: Mapping[str, float], task: Task) -> float:
        """None that a descent could follow."""
        return 0.0

    def resized(self, before: FloatArray, after: FloatArray) -> float:
        """Its slopes stay as they are."""
        return 0.0
