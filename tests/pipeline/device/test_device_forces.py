"""Forces of several devices at once: each device has the force that it has alone, and laws that cannot do so are told apart."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.device.device_forces import DevicePoints, Elements, force_of_devices, laws_of_devices, takes_devices
from pipeline.device.effect import find_effects
from pipeline.device.force_law import Laws, force_along

FORCES = {name: e for name, e in find_effects(()).items() if e.force is not None and not e.has_coordinates}


def _branching(t, q, qd, u, p, laws, out):
    for i in range(laws.axes):
        if q[i] > 0.0:
            out[i] -= p[0] * q[i]


def _devices(count: int) -> tuple[DevicePoints, list[Laws]]:
    random = np.random.default_rng(6)
    q, qd, u = (s * random.standard_normal((k, count, 4, 5)) for k, s in ((3, 1e-4), (3, 0.3), (2, 1.0)))
    motion = (Elements(each.shape[0], each.__getitem__) for each in (q, qd, u))
    drawn = random.standard_normal
    laws = [Laws(drawn((3, 3)), drawn((3, 3)), drawn((3, 2)), drawn((2, 3)), 5.0, 5.0, 2) for _ in range(count)]
    return DevicePoints(random.random(5), *motion, (count, 4, 5)), laws


@pytest.mark.parametrize("name", [n for n, e in FORCES.items() if takes_devices(e.force, len(e.parameters))])
def test_a_device_has_the_force_that_it_has_alone_bit_for_bit(name: str) -> None:
    effect = FORCES[name]
    p = np.array([one.scale for one in effect.parameters])
    points, laws = _devices(3)
    together = force_of_devices(effect.force, points, p, laws_of_devices(laws, 3))
    for device, own in enumerate(laws):
        alone = force_along(effect.force, points.of(device), p, own)
        found = [np.zeros(20) if one is None else one[device].ravel() for one in together]
        np.testing.assert_array_equal(np.stack(found), alone)


def test_most_laws_of_the_library_take_devices_and_a_law_that_branches_does_not() -> None:
    assert sum(takes_devices(e.force, len(e.parameters)) for e in FORCES.values()) >= 0.8 * len(FORCES)
    assert not takes_devices(_branching, 1)
