"""The paper's four thetas from measured residues, corrected for the fitted effects.

    c~_m = c_m - [c_m(plant and effects) - c_m(plant alone)]        at the fitted parameters
    c~ --(16), (18)--> theta_u1, theta_v1, theta_u2, theta_v2       the paper's equations

With the right model the four agree, so their spread measures what the effects do not explain; the remaining misfit stays in c~.
The sd of the thetas is that of the noise of the residues, propagated through the route with the effects held fixed.

Shapes: M recorded modes, S senses, D drives; theta in deg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...axial import mean_axis, wrap
from ...experiment.files.modal_record import ModalRecord
from .model import gyro_route, measured_modes

NAMES: tuple[str, ...] = ("theta_u1_deg", "theta_v1_deg", "theta_u2_deg", "theta_v2_deg")
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class FourThetas:
    """theta_u1, theta_v1, theta_u2, theta_v2 (4,) [deg] and their sd (4,) [deg]."""

    theta_deg: FloatArray
    sd_deg: FloatArray

    @property
    def spread_deg(self) -> float:
        """Largest less smallest deviation from the axial mean [deg]."""
        deviations = np.array([float(wrap(t - mean_axis(self.theta_deg))) for t in self.theta_deg])
        return float(deviations.max() - deviations.min())


def four_thetas(record: ModalRecord, effects: ComplexArray, noise: FloatArray) -> FourThetas:
    """The four thetas of a 2 x 2 record.

    Parameters
    ----------
    record : as measured.
    effects : contribution of the effects to c (M, S, D) [1/s].
    noise : sd of R1 and R0 / w (M, 2, S, D) [1/s].

    Raises
    ------
    IdentificationError : the corrected modes are not two rocking modes and one up-down mode.
    """
    c = measured_modes(record).c - effects
    centre = _route(record, c)
    variance = np.zeros(4)
    for k, unit in enumerate((1.0j, 1.0)):
        for place in np.ndindex(c.shape):
            moved = c.copy()
            step = _STEP * float(np.linalg.norm(c[place[0]]))
            moved[place] += unit * step
            slope = np.array([float(wrap(d)) for d in _route(record, moved) - centre]) / step
            variance += (slope * noise[(place[0], k, *place[1:])]) ** 2
    return FourThetas(centre, np.sqrt(variance))


def _route(record: ModalRecord, c: ComplexArray) -> FloatArray:
    omega = 2.0 * np.pi * record.frequency_hz[:, None, None]
    return gyro_route(replace(record, R1=c.imag, R0=omega * c.real)).axes.theta_deg
