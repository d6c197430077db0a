"""Plant "gyro": the parameters of the paper's device, its electrodes in any frame, with or without the up-down mode.

Shapes: P parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from ..arrays import FloatArray
from .gyro import M_D, M_S, PHYSICAL, gyro_mechanics, to_cartesian, to_physical
from .mechanics import Mechanics
from .parameters import Parameter, Shape

C12 = "c12_per_s"
_GYRO_PARAMETERS = (
    Parameter("f1_hz", "Hz", 1.0, 1e6, "undamped frequency of the lower rocking axis"),
    Parameter("f2_hz", "Hz", 1.0, 1e6, "undamped frequency of the upper rocking axis"),
    Parameter("f3_hz", "Hz", 1.0, 1e6, "undamped frequency of the up-down mode"),
    Parameter("zeta1", "1", 0.0, 0.5, "damping ratio c11 / (2 omega1)"),
    Parameter("zeta2", "1", 0.0, 0.5, "damping ratio c22 / (2 omega2)"),
    Parameter("zeta3", "1", 0.0, 0.5, "damping ratio of the up-down mode"),
    Parameter("theta_deg", "deg", -90.0, 90.0, "angle of the lower-frequency stiffness axis from the x axis"),
    Parameter("rocking_gain", "1/s", 0.0, 1e6, "drive volts to rocking motion in pick-off volts"),
    Parameter("updown_gain", "1/s", 0.0, 1e6, "drive volts to up-down motion in pick-off volts"),
    Parameter("sense_imbalance", "1", -0.99, 0.99, "(K_S2 - K_S1)/(K_S2 + K_S1)"),
    Parameter("drive_imbalance", "1", -0.99, 0.99, "(K_D2 - K_D1)/(K_D2 + K_D1)"),
)
GYRO_SHAPE = Shape(2, 2, ("x", "y"))
#: Values of the parameters of the up-down mode where the plant has none: any, because it is left out.
_UPDOWN = {"f3_hz": 1.0, "zeta3": 0.1, "updown_gain": 1.0}
_WITHOUT_C12 = tuple(i for i, name in enumerate(PHYSICAL) if name != C12)


def _turn(angle_deg: float) -> FloatArray:
    """Rot (3, 3) by an angle about z."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _first(array: FloatArray, name: str, n: int) -> FloatArray:
    """The part of a field of :class:`Mechanics` that belongs to the first n coordinates."""
    if name == "drive":
        return array[:, :n].copy()
    return array[:, :, :n].copy() if name.endswith("_sense") else array[:, :n, :n].copy()


@lru_cache(maxsize=64)
def _gyro_mechanics(physical: tuple[float, ...]) -> Mechanics:
    """Kept, because finite differences of the parameters of effects ask for the same plant again."""
    return gyro_mechanics(np.array([physical]))


@dataclass(frozen=True)
class GyroPlant:
    """The gyro of the paper: eleven parameters, two drives, two senses; without c12 the damping axes are the stiffness axes.

    Smooth coordinates (``pipeline.device.gyro``): omega0, eps_c, eps_s, c0, then d_c, d_s with c12 or delta = (c11 - c22)/2
    without c12, then omega3, c33, ln G_r, ln G_z, s, d.

    Parameters
    ----------
    shape : with the scale of the records.
    frame_deg : angles phi of the sense and of the drive electrodes of the paper in the frame in which theta is stated.
    updown : whether the electrodes drive and sense the up-down mode.
    """

    shape: Shape = GYRO_SHAPE
    frame_deg: tuple[float, float] = (0.0, 0.0)
    updown: bool = True

    @property
    def kinds(self) -> frozenset[str]:
        """{"gyro"}, and "updown" with the third mode."""
        return frozenset({"gyro", "updown"} if self.updown else {"gyro"})

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The eleven parameters, or the eight that do not belong to the up-down mode."""
        return tuple(p for p in _GYRO_PARAMETERS if self.updown or p.name not in _UPDOWN)

    def mechanics(self, values: Mapping[str, float]) -> Mechanics:
        """Mechanics in (psi_x, psi_y, z) or (psi_x, psi_y) with c12 = 0; the effect offdiagonal_damping adds c12."""
        all_values = values if self.updown else {**values, **_UPDOWN}
        kept = _gyro_mechanics(tuple(0.0 if name == C12 else all_values[name] for name in PHYSICAL))
        found = Mechanics(*(getattr(kept, field.name).copy() for field in fields(kept)))
        if any(self.frame_deg):
            found.velocity_sense[0] = found.velocity_sense[0] @ _turn(self.frame_deg[0]).T
            found.drive[0] = _turn(self.frame_deg[1]) @ found.drive[0]
        n = 3 if self.updown else 2
        return found if self.updown else Mechanics(*(_first(getattr(found, f.name), f.name, n) for f in fields(found)))

    def sense_motion(self) -> FloatArray:
        """(2, 3) [1]: x = M_S Rot(-phi) psi + z [V s], M_S of the paper, eq. (10); (2, 2) without z."""
        motion = np.concatenate([M_S, np.ones((2, 1))], axis=1) @ _turn(self.frame_deg[0]).T
        return np.asarray(motion if self.updown else motion[:, :2])

    def drive_motion(self) -> FloatArray:
        """(2, 3) [1]: x = (Rot(phi) M_D)^T psi + z [V s], M_D of the paper, eq. (9); (2, 2) without z."""
        motion = np.concatenate([M_D.T, np.ones((2, 1))], axis=1) @ _turn(self.frame_deg[1]).T
        return np.asarray(motion if self.updown else motion[:, :2])

    def to_internal(self, physical: FloatArray) -> FloatArray:
        """Cartesian parameters (12,) with c12, or the smooth coordinates (11,) without c12 [rad/s, 1/s, 1].

        Without the up-down mode, omega3, c33 and ln G_z are left out.
        """
        if self.updown:
            return self._smooth(physical)
        own = [p.name for p in self.parameters]
        named = {**dict(zip(own, physical)), **_UPDOWN}
        full = np.append([named[p.name] for p in _GYRO_PARAMETERS], physical[len(own) :])
        return np.delete(self._smooth(full), self._absent(full.size))

    def to_external(self, internal: FloatArray) -> FloatArray:
        """The inverse of :meth:`to_internal`: values (.., P) [declared units]."""
        if self.updown:
            return self._values(internal)
        size = internal.shape[-1] + 3
        absent = self._absent(size)
        full = np.zeros((*internal.shape[:-1], size))
        full[..., [i for i in range(size) if i not in absent]] = internal
        full[..., absent[:2]] = 1.0
        values = self._values(full)
        kept = [i for i in range(size) if i >= len(_GYRO_PARAMETERS) or _GYRO_PARAMETERS[i].name not in _UPDOWN]
        return np.asarray(values[..., kept])

    @staticmethod
    def _absent(size: int) -> list[int]:
        """Places of omega3, c33 and ln G_z among ``size`` smooth coordinates."""
        return [size - 6, size - 5, size - 3]

    def _smooth(self, physical: FloatArray) -> FloatArray:
        full = np.zeros(12)
        full[list(_WITHOUT_C12)] = physical[:11]
        if physical.size == 12:
            full[PHYSICAL.index(C12)] = physical[11]
        x = to_cartesian(full[None])[0]
        if physical.size == 12:
            return np.asarray(x)
        double = np.deg2rad(2.0 * full[PHYSICAL.index("theta_deg")])
        delta = x[4] * np.cos(double) + x[5] * np.sin(double)
        return np.concatenate([x[:4], [delta], x[6:]])

    def _values(self, internal: FloatArray) -> FloatArray:
        if internal.shape[-1] == 12:
            return np.asarray(to_physical(internal)[..., [*_WITHOUT_C12, PHYSICAL.index(C12)]])
        split = np.hypot(internal[..., 1:2], internal[..., 2:3])
        axis = np.where(split > 0.0, -internal[..., 1:3] / np.where(split > 0.0, split, 1.0), [1.0, 0.0])
        x = np.concatenate([internal[..., :4], internal[..., 4:5] * axis, internal[..., 5:]], axis=-1)
        return np.asarray(to_physical(x)[..., list(_WITHOUT_C12)])

    def steps(self, internal: FloatArray) -> FloatArray:
        """(P,): 1e-4 [rad/s, 1/s], 1e-5 for gains and imbalances; a resonance is about 1 rad/s wide, a record 1 s long."""
        gains = 4 if self.updown else 3
        return np.array([1e-4] * (internal.size - gains) + [1e-5] * gains)
