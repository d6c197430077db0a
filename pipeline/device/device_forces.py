"""Force laws along the motions of several devices at once: as many calls as one device needs.

A law that is plain arithmetic takes an array over devices and points in place of each of its numbers, those of its parameters
and of the matrices of the mechanics included.  Arithmetic acts on each element alone, so a device has the force that it has
alone, bit for bit.

Shapes: B devices, n coordinates, D drives, k parameters, m points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..arrays import RealArray
from .force_law import Laws, Points, Vectors, force_along, takes_vectors


class Elements(Sequence[Any]):
    """``size`` vectors in place of the numbers of an array, each made when it is first read: few laws read all of a motion."""

    def __init__(self, size: int, make: Callable[[int], Any]) -> None:
        self.size, self._make = size, make
        self._made: dict[int, Any] = {}

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, i: Any) -> Any:
        i = range(self.size)[i]
        if i not in self._made:
            self._made[i] = self._make(i)
        return self._made[i]


@dataclass(frozen=True, eq=False)
class DevicePoints:
    """Points of a motion of each device: t [s], and q (n,) [V s], qd (n,) [V], u (D,) [V], whose elements broadcast to ``shape``.

    The devices are the first axis of ``shape`` (B, .., m).
    """

    t: RealArray
    q: Sequence[Any]
    qd: Sequence[Any]
    u: Sequence[Any]
    shape: tuple[int, ...]

    def of(self, device: int) -> Points:
        """The points of one device, in double precision."""

        def flat(element: RealArray) -> RealArray:
            return np.asarray(np.broadcast_to(element, self.shape)[device].ravel(), dtype=np.float64)

        return Points(flat(self.t), *(np.stack([flat(one) for one in each]) for each in (self.q, self.qd, self.u)))


def laws_of_devices(laws: Sequence[Laws], axes: int) -> Laws:
    """The laws of devices with the same conditions as one, whose matrices have elements (B, 1, ..) of ``axes`` axes."""

    together: dict[str, Any] = {}
    for name in ("damping", "stiffness", "drive", "motion"):
        matrices = np.stack([getattr(one, name) for one in laws], axis=-1)
        together[name] = matrices.reshape(*matrices.shape, *[1] * (axes - 1))
        # A law that changes an element in place fails instead of changing the mechanics.
        together[name].flags.writeable = False
    return laws[0]._replace(**together)


def force_of_devices(
    force: Callable[..., None], points: DevicePoints, p: RealArray, laws: Laws
) -> list[RealArray | None]:
    """The force [V/s] on each of n coordinates, of the shape of the points; ``None`` where the law does not act.

    Only for a law that :func:`takes_devices`, in the precision of the points.

    Parameters
    ----------
    force, points : the law, and the motion of each device.
    p : (k,), or those of each device (k, B, .., m).
    laws : of :func:`laws_of_devices`.
    """
    out = Vectors([0.0] * len(points.q))
    force(points.t, points.q, points.qd, points.u, p, laws, out)
    return [None if type(own) is float else _whole(own, points) for own in out]


def _whole(force: Any, points: DevicePoints) -> RealArray:
    """A force as an array of the shape and the precision of the points."""
    if getattr(force, "shape", None) != points.shape:
        force = np.broadcast_to(force, points.shape)
    return np.ascontiguousarray(force, dtype=points.t.dtype)


@lru_cache(maxsize=256)
def takes_devices(force: Callable[..., None], parameters: int) -> bool:
    """Whether a law gives devices with mechanics and parameters of their own what it gives each of them alone."""
    if not takes_vectors(force, parameters):
        return False
    random = np.random.default_rng(1)
    motion = [random.standard_normal((k, 2, 4)) for k in (3, 3, 2)]
    t, p = random.random(4), np.broadcast_to(random.random((parameters, 2, 1)), (parameters, 2, 4))
    for each in (t, *motion):
        # A law that changes a vector in place would change its input.
        each.flags.writeable = False
    drawn = random.standard_normal
    laws = [Laws(drawn((3, 3)), drawn((3, 3)), drawn((3, 2)), drawn((2, 3)), 5.0, 5.0, 2) for _ in range(2)]
    q, qd, u = (Elements(each.shape[0], each.__getitem__) for each in motion)
    points = DevicePoints(t, q, qd, u, (2, 4))
    try:
        found = force_of_devices(force, points, p, laws_of_devices(laws, 2))
    except Exception:
        # Arrays differ from numbers in more ways than can be listed; each device alone is right in any case.
        return False
    together = np.stack([np.zeros(points.shape) if one is None else one for one in found], axis=1)
    alone = [force_along(force, points.of(b), p[:, b, 0], own) for b, own in enumerate(laws)]
    return bool(np.allclose(together, np.stack(alone), rtol=1e-12, atol=0.0))
