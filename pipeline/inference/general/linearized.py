"""Residuals whose nonlinear response is linearized in the parameters of the force and sense laws.

    y(x) = linear(x) + r(x0) + sum_i dr/dx_i (x_i - x0_i)                i over the parameters of those laws

Where the nonlinear response r is weak, a fit converges nearly all the way on these residuals, without the integrator.

Shapes: R records of a drive group, N samples, S senses, P free parameters.
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
    """``exact`` linearized at complete ``values`` and initial states ``starts``; ``steps`` (P,) of its columns."""

    def __init__(
        self, exact: CampaignResiduals, values: Mapping[str, float], tasks: Tasks, starts: Starts, steps: FloatArray
    ) -> None:
        self.threads, self.model, self.noise = exact.threads, exact.model, exact.noise
        self.instrument, self.angular_gain = exact.instrument, exact.angular_gain
        self._x0 = self.model.to_internal(values)
        own = [i for i, name in enumerate(self.model.free) if is_integrated(self.model, name)]
        self._nonlinear: list[FloatArray] = []
        self._slopes: list[NonlinearColumns] = []
        for places, group in tasks.groups:
            states = [starts[i] for i in places]
            self._nonlinear.append(nonlinear_response(self.system(values, group), group, states))
            self._slopes.append(nonlinear_columns(self.model, values, group, self.instrument, steps, own, states))

    def _volts(
        self, number: int, values: Mapping[str, float], system: System, group: DriveGroup, starts: Starts
    ) -> FloatArray:
        moved = self.model.to_internal(values) - self._x0
        y = linear_volts(system, group, starts) + self._nonlinear[number]
        for i, column in self._slopes[number].items():
            y += moved[i] * column
        return y

    def _nonlinear_columns(self, number: int) -> NonlinearColumns:
        return self._slopes[number]

    def strength(self, values: Mapping[str, float], task: Task, start: FloatArray | None = None) -> float:
        """0 [1]: there is no nonlinear response to differentiate."""
        return 0.0

    def relative_size_change(self, before: FloatArray, after: FloatArray) -> float:
        """0 [1] for all x (P,): the columns of the force and sense laws are constant."""
        return 0.0
