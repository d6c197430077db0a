"""Levitation: the fringe field of a drive electrode lifts the rotor."""

from __future__ import annotations

from ...arrays import FloatArray
from ..effect import Effect, Laws, SizeRange
from ..parameters import Parameter


def force(t: float, q: FloatArray, qd: FloatArray, u: FloatArray, p: FloatArray, laws: Laws, out: FloatArray) -> None:
    """Add eps F_z u^2 / (2 V_b) [V/s] to the up-down coordinate of ``out`` (n,); u (D,) [V], p[0] = eps [1]."""
    for k in range(u.size):
        out[laws.axes] += p[0] * laws.drive[laws.axes, k] * u[k] * u[k] / (2.0 * laws.bias_v)


EFFECT = Effect(
    name="levitation_force",
    law="z'' += eps sum_k F_zk v_k^2 / (2 V_b):  what (V_b + v_k)^2 adds to the linear drive of the up-down mode",
    latex=r"z'' = \cdots + \varepsilon \sum_k F_{zk}\,\frac{v_k^2}{2 V_b}",
    source="Tang, Lim & Howe, JMEMS 1 (1992) 170: F_z = gamma_z V^2 (z_0 - z)/z_0; constant and linear parts are the plant's",
    signature="up-down motion at zero and twice the drive frequency, ~ level squared, equal in both channels; no rocking",
    parameters=(Parameter("eps", "1", -20.0, 20.0, "fringe force over the up-down drive, at v = 2 V_b", scale=0.1),),
    force=force,
    plants=("updown",),
    depends_on_bias=True,
    size=SizeRange(0.5, 10.0),
)
