"""Batches of symmetric 2 x 2 matrices, each as a mean and a complex 2-theta anisotropy.

    A = a0 I + [[Re a, Im a], [Im a, -Re a]],      eigenvalues a0 +- |a|,      axis of the larger one at arg(a) / 2
    a rotation by phi multiplies a by exp(2 i phi)

The symmetric product A.B = (A B + B A) / 2 has the same form, and N A N = 2 N.(N.A) - (N.N).A.

Shapes: B devices.  Source: Jordan algebra of spin factors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pipeline.arrays import ComplexArray, FloatArray


def as_complex(real: FloatArray, imag: FloatArray) -> ComplexArray:
    """real + i imag, both of one shape and unit; a product with 1j would round and could change the sign of zeros."""
    result = np.empty(np.shape(real), dtype=np.complex128)
    result.real, result.imag = real, imag
    return result


class Symmetric(NamedTuple):
    """Mean a0 (B,) and anisotropy a (B,), in the unit of the matrix."""

    mean: FloatArray
    anisotropy: ComplexArray


def product(a: Symmetric, b: Symmetric) -> Symmetric:
    """A.B = (A B + B A) / 2 of B matrices each."""
    inner = a.anisotropy.real * b.anisotropy.real + a.anisotropy.imag * b.anisotropy.imag
    return Symmetric(a.mean * b.mean + inner, a.mean * b.anisotropy + b.mean * a.anisotropy)


def congruence(n: Symmetric, a: Symmetric) -> Symmetric:
    """N A N = 2 N.(N.A) - (N.N).A of B matrices each."""
    twice, square = product(n, product(n, a)), product(product(n, n), a)
    return Symmetric(2.0 * twice.mean - square.mean, 2.0 * twice.anisotropy - square.anisotropy)


def inverse_root(m: Symmetric) -> Symmetric:
    """M^(-1/2) of a positive definite M: eigenvalues (m0 +- |m|)^(-1/2) on the same axes."""
    size = np.hypot(m.anisotropy.real, m.anisotropy.imag)
    high, low = 1.0 / np.sqrt(m.mean - size), 1.0 / np.sqrt(m.mean + size)
    # (low - high) / (2 |m|), rewritten to avoid 0 / 0 at |m| = 0.
    slope = -(low * low * high * high) / (low + high)
    return Symmetric((low + high) / 2.0, slope * m.anisotropy)


def axis_deg(anisotropy: ComplexArray) -> FloatArray:
    """Angle (B,) [deg] in (-90, 90] of the axis of the smaller eigenvalue."""
    lower = np.rad2deg(np.arctan2(anisotropy.imag, anisotropy.real)) / 2.0 + 90.0
    return np.where(lower > 90.0, lower - 180.0, lower)


def rotated(anisotropy: ComplexArray, theta_deg: FloatArray) -> ComplexArray:
    """The anisotropy (B,) in axes rotated by theta (B,) [deg]: a exp(-2 i theta), unit unchanged."""
    double = np.deg2rad(2.0 * theta_deg)
    c, s = np.cos(double), np.sin(double)
    x, y = anisotropy.real, anisotropy.imag
    return as_complex(x * c + y * s, y * c - x * s)
