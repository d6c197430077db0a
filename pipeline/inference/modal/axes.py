"""The paper's four thetas with the fitted effects taken out of the measured residues.

    c~_m = c_m - [c_m(plant and effects) - c_m(plant alone)]        at the fitted parameters
    c~ --(16), (18)--> theta_u1, theta_v1, theta_u2, theta_v2

Were the model right, the four would agree; so their spread tells what the effects do not explain.  What is left of the
misfit stays in c~: nothing is smoothed.  The sd are those of the residues' noise through the route, the effects held.
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
    """u1, v1, u2, v2 (4,) [deg], each with its sd (4,) [deg]."""

    theta_deg: FloatArray
    sd_deg: FloatArray

    @property
    def spread_deg(self) -> float:
        """Largest less smallest, as angles from the axial mean [deg]."""
        off = np.array([float(wrap(t - mean_axis(self.theta_deg))) for t in self.theta_deg])
        return float(off.max() - off.min())


def four_thetas(record: ModalRecord, effects: ComplexArray, noise: FloatArray) -> FourThetas:
    """The four thetas of a 2 x 2 record.

    Parameters
    ----------
    record : as measured.
    effects : (M, S, D) what the effects add to c [1/s].
    noise : (M, 2, S, D) sd of R1 and R0 / w [1/s].

    Raises
    ------
    IdentificationError : what is left are not two rocking modes and one up-down mode.
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
