"""Force laws along many points at once: with vectors where the law is plain arithmetic, compiled where it branches."""

import math

import numpy as np

from pipeline.device.force_law import Laws, Points, force_along, takes_vectors
from pipeline.inference.screening.undetected.library import probes_of

POINTS = Points(np.arange(5.0), *(np.random.default_rng(k).standard_normal((k, 5)) for k in (3, 3, 2)))
LAWS = Laws(np.eye(3), np.eye(3), np.ones((3, 2)), np.ones((2, 3)), 5.0, 5.0, 2)


def friction(t, q, qd, u, p, laws, out):
    """Coulomb friction on the first coordinate, of size p[0] exp(p[1])."""
    if qd[0] > 0.0:
        out[0] -= p[0] * math.exp(p[1])
    else:
        out[0] += p[0] * math.exp(p[1])


def in_place(t, q, qd, u, p, laws, out):
    """A law that reuses a local name: with vectors it would change its input."""
    x = q[0]
    x *= p[0]
    out[0] += x * q[0]


def test_a_law_that_branches_is_compiled():
    assert not takes_vectors(friction, 2)
    found = force_along(friction, POINTS, np.array([2.0, 0.5]), LAWS)
    np.testing.assert_allclose(found[0], -2.0 * np.exp(0.5) * np.sign(POINTS.qd[0]), rtol=1e-14)
    assert not found[1:].any()


def test_a_law_that_would_change_its_input_is_compiled():
    assert not takes_vectors(in_place, 1)


def test_all_laws_of_the_library_take_vectors():
    # A law that does not costs a new process its compilation.
    probes = probes_of(True, "force")
    assert len(probes) >= 6
    assert all(takes_vectors(probe.effect.force, probe.size) for probe in probes)
