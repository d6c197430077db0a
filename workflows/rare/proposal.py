"""The proposal: a mixture of normals that covers the regions of loss.

    q(z) = a N(z; 0, I) + (1 - a) sum_k c_k N(z; m_k, I + U_k diag(v_k) U_k^T),   a = ``DEFENSIVE``, v_k >= 0

fitted by weighted expectation maximisation, which minimises the cross entropy from the distribution of lost devices.  Two
components are guards, N(0, S) with S = E z z^T of the lost devices and N(0, tr S / a): they cover what lies between, opposite and
beside the others.  No covariance is
below I and the nominal population is a part of q, so the weight N(z; 0, I) / q(z) is at most 1 / a and the variance of an
estimate is finite.  The fit takes place in a few ``directions``, and covariances are shrunk, so that latent normals without
influence cost nothing.

Shapes: n devices, d latent normals, K components.
Source: Rubinstein, Kroese, The Cross-Entropy Method (2004); Kurtz, Song, Structural Safety 42 (2013) 35 (mixtures); Owen, Zhou,
JASA 95 (2000) 135 (defensive mixtures); Ledoit, Wolf, J. Multivariate Analysis 88 (2004) 365 (shrinkage).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from pipeline.arrays import FloatArray, IntArray

#: Share of the nominal population in the proposal, and of the guards in what is fitted to a side.
DEFENSIVE, GUARD = 0.1, 0.2
#: Numbers of components that are tried; a ring of loss at 5 sd needs about ten.
_COMPONENTS = (1, 2, 3, 4, 6, 8, 12, 16)
_ITERATIONS = 30
#: Fewest independent devices of a component.
_OWN = 5


@dataclass(frozen=True, eq=False)
class Component:
    """N(mean, I + basis diag(extra) basis^T): mean (d,), orthonormal basis (d, r), extra variance (r,) > 0."""

    mean: FloatArray
    basis: FloatArray
    extra: FloatArray

    def log_density(self, z: FloatArray) -> FloatArray:
        """ln of the density (n,) at z (n, d), without the constant -d/2 ln(2 pi)."""
        away = z - self.mean
        along = away @ self.basis
        square = np.sum(away * away, axis=1) - np.sum(along * along * (self.extra / (1.0 + self.extra)), axis=1)
        return np.asarray(-0.5 * (square + np.sum(np.log1p(self.extra))))

    def drawn(self, normal: FloatArray) -> FloatArray:
        """Devices (n, d) from standard normals (n, d)."""
        along = normal @ self.basis
        return np.asarray(self.mean + normal + (along * (np.sqrt(1.0 + self.extra) - 1.0)) @ self.basis.T)


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture: components and their shares (K,), which add up to one."""

    components: tuple[Component, ...]
    share: FloatArray

    def drawn(self, count: int, random: np.random.Generator) -> FloatArray:
        """``count`` independent devices (count, d)."""
        which: IntArray = random.choice(len(self.components), size=count, p=self.share)
        normal = random.standard_normal((count, self.components[0].mean.size))
        z = np.empty_like(normal)
        for k, component in enumerate(self.components):
            z[which == k] = component.drawn(normal[which == k])
        return z

    def weights(self, z: FloatArray) -> FloatArray:
        """N(z; 0, I) / q(z) (n,) at z (n, d)."""
        return np.asarray(np.exp(-0.5 * np.sum(z * z, axis=1) - logsumexp(self._each(z), axis=0)))

    def _each(self, z: FloatArray) -> FloatArray:
        """ln(share) + ln of the density of each component, (K, n)."""
        return np.stack([math.log(s) + one.log_density(z) for s, one in zip(self.share.tolist(), self.components)])


def nominal(dimension: int) -> Component:
    """N(0, I)."""
    return Component(np.zeros(dimension), np.empty((dimension, 0)), np.empty(0))


def defensive(parts: Sequence[Mixture], dimension: int) -> Mixture:
    """The nominal population and, in equal shares, ``parts``."""
    if not parts:
        return Mixture((nominal(dimension),), np.ones(1))
    share = [np.array([DEFENSIVE]), *((1.0 - DEFENSIVE) / len(parts) * part.share for part in parts)]
    components = [component for part in parts for component in part.components]
    return Mixture((nominal(dimension), *components), np.concatenate(share))


def fitted(
    z: FloatArray, weight: FloatArray, independent: float, directions: FloatArray, random: np.random.Generator
) -> Mixture:
    """The mixture, of the number of components that minimises BIC, of lost devices.

    Parameters
    ----------
    z : lost devices (n, d).
    weight : of each (n,); any scale.
    independent : number of independent devices that they are worth.
    directions : orthonormal (d, a); across them the devices are those of the population.
    random : chooses where the components start.
    """
    share = weight / np.sum(weight)
    own = z @ directions
    found: list[tuple[float, Mixture]] = []
    for count in _COMPONENTS:
        # A component needs a few devices of its own.
        if count > 1 and count * _OWN > independent:
            break
        found.append(_mixture(own, share, count, independent, random))
        if len(found) > 2 and found[-1][0] > found[-2][0] > found[-3][0]:
            break
    best = min(found, key=lambda one: one[0])[1]
    second = (own * share[:, None]).T @ own
    nothing, everywhere = np.zeros(len(second)), np.trace(second) / len(second) * np.eye(len(second))
    guards = tuple(Component(nothing, *_extra(one, independent)) for one in (second, everywhere))
    components = (*best.components, *guards)
    shares = np.concatenate([(1.0 - GUARD) * best.share, [0.5 * GUARD, 0.5 * GUARD]])
    return Mixture(tuple(_embedded(one, directions) for one in components), shares)


def _embedded(component: Component, directions: FloatArray) -> Component:
    """A component in the ``directions`` (d, a) as one of all d latent normals."""
    return Component(directions @ component.mean, np.ascontiguousarray(directions @ component.basis), component.extra)


def _mixture(
    z: FloatArray, weight: FloatArray, count: int, independent: float, random: np.random.Generator
) -> tuple[float, Mixture]:
    """BIC and the mixture of ``count`` components by expectation maximisation; ``weight`` (n,) adds up to one."""
    part = _start(z, weight, count, random)
    mixture, before = _maximised(z, weight, part, independent), -math.inf
    for _ in range(_ITERATIONS):
        each = mixture._each(z)
        total = logsumexp(each, axis=0)
        likelihood = float(weight @ total)
        if likelihood < before + 1e-3 / independent:
            break
        before = likelihood
        mixture = _maximised(z, weight, np.exp(each - total), independent)
    likelihood = float(weight @ logsumexp(mixture._each(z), axis=0))
    free = sum(np.count_nonzero(one.mean) + one.basis.size for one in mixture.components) + len(mixture.components) - 1
    return -2.0 * independent * likelihood + free * math.log(max(independent, 2.0)), mixture


def _start(z: FloatArray, weight: FloatArray, count: int, random: np.random.Generator) -> FloatArray:
    """Part (K, n) of each device in each component: nearest of ``count`` devices that lie far apart (k-means++)."""
    chosen = [int(random.choice(len(z), p=weight))]
    distance = np.sum((z - z[chosen[0]]) ** 2, axis=1)
    for _ in range(count - 1):
        far = weight * distance
        if not np.sum(far) > 0.0:
            break
        chosen.append(int(random.choice(len(z), p=far / np.sum(far))))
        distance = np.minimum(distance, np.sum((z - z[chosen[-1]]) ** 2, axis=1))
    nearest = np.argmin(np.stack([np.sum((z - z[k]) ** 2, axis=1) for k in chosen]), axis=0)
    return np.asarray(nearest == np.arange(len(chosen))[:, None], dtype=np.float64)


def _maximised(z: FloatArray, weight: FloatArray, part: FloatArray, independent: float) -> Mixture:
    """The components that maximise the likelihood, given the part (K, n) of each device in each."""
    owned = part * weight
    share = np.sum(owned, axis=1)
    # A component without devices of its own would be fitted to chance.
    kept = np.flatnonzero(share * independent >= _OWN)
    if not len(kept):
        kept = np.array([int(np.argmax(share))])
    components = [_component(z, owned[k] / share[k], share[k] * independent) for k in kept]
    return Mixture(tuple(components), share[kept] / np.sum(share[kept]))


def _component(z: FloatArray, weight: FloatArray, independent: float) -> Component:
    """The component of devices (n, d) with weights (n,) that add up to one."""
    mean = weight @ z
    away = z - mean
    return Component(mean, *_extra((away * weight[:, None]).T @ away, independent))


def _extra(covariance: FloatArray, independent: float) -> tuple[FloatArray, FloatArray]:
    """Basis and extra variance of a sample covariance S (a, a) of ``independent`` devices, shrunk towards m I, m = tr S / a.

    (1 - t) S + t m I,   t = min(1, (tr S^2 + (tr S)^2) / (independent |S - m I|^2))        of normal devices
    """
    trace, size = float(np.trace(covariance)), len(covariance)
    square = float(np.sum(covariance**2))
    spread = square - trace * trace / size
    shrink = min(1.0, (square + trace * trace) / max(independent * spread, 1e-12))
    values, vectors = np.linalg.eigh((1.0 - shrink) * covariance + shrink * trace / size * np.eye(size))
    wide = values > 1.0
    return np.ascontiguousarray(vectors[:, wide]), values[wide] - 1.0
