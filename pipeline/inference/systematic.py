"""What the common errors of a tester do to the quantities of its devices.

An error moves the parameters that were identified to those that the device has, with the z of ``experiment.systematic``:

    clock        rates scale:          f, c12, gains times r,   r = 1 + 1e-6 s_clock z
    temperature  stiffness scales:     f times k, zeta / k (damping rates stay),   k = 1 + 1e-6 TCF s_T z
    gain         volts scale:          gains times exp(s_g z)
    phase, angular gain                rate biases by their own formula, at phi + s_phi z and kappa exp(s_kappa z / kappa)

theta, imbalances and the ratio of the split to f1 are ratios of what one tester measured; no common error moves them.  Posterior
draw i takes node z_i of a Latin hypercube that is the same for all devices, so that draws of different devices are correlated.

Shapes: n draws or nodes, five errors, 12 physical parameters.  Units of ``pipeline.quantities``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from ..arrays import FloatArray, IntArray, by_column
from ..device.gyro import PHYSICAL, to_physical
from ..device.gyro import split_hz as cartesian_split_hz
from ..experiment.record import Campaign
from ..experiment.systematic import Systematic
from .estimate import RateSettings, quantities

_RATES = [PHYSICAL.index(name) for name in ("f1_hz", "f2_hz", "f3_hz", "c12_per_s", "rocking_gain", "updown_gain")]
_FREQUENCIES = [PHYSICAL.index(name) for name in ("f1_hz", "f2_hz", "f3_hz")]
_DAMPINGS = [PHYSICAL.index(name) for name in ("zeta1", "zeta2", "zeta3")]
_GAINS = [PHYSICAL.index(name) for name in ("rocking_gain", "updown_gain")]
_ERRORS = 5
#: Gains of plant "modal"; a clock error, in ppm, is small beside a gain error.
_MODAL_GAIN = re.compile(r"gain\d+_s\d+d\d+")
#: Seed of the nodes: quadrature points of an integral, not realisations, so every device and every run has the same.
_SEED = 13


@lru_cache(maxsize=8)
def common_nodes(count: int) -> FloatArray:
    """Latin hypercube of standard normals (count, 5), the same for all devices; columns: ndtri((k + 1/2)/count), permuted."""
    random = np.random.default_rng(np.random.SeedSequence(_SEED, spawn_key=(count,)))
    column = ndtri((np.arange(count) + 0.5) / count)
    nodes = np.stack([random.permutation(column) for _ in range(_ERRORS)], axis=1)
    nodes.setflags(write=False)
    return nodes


@dataclass(frozen=True, eq=False)
class Identified:
    """Posterior draws of a device as its tester measured them: physical (n, 12), split (n,) [Hz], and what is declared."""

    physical: FloatArray
    split_hz: FloatArray
    rate: RateSettings

    @classmethod
    def of_cartesian(cls, x: FloatArray, rate: RateSettings) -> Identified:
        """From cartesian draws (n, 12), the split free of cancellation."""
        return cls(to_physical(x), cartesian_split_hz(x), rate)

    @classmethod
    def of_physical(cls, physical: FloatArray, rate: RateSettings) -> Identified:
        """From physical draws (n, 12); the split is f2 - f1."""
        return cls(physical, physical[:, PHYSICAL.index("f2_hz")] - physical[:, PHYSICAL.index("f1_hz")], rate)

    def thinned(self, kept: IntArray) -> Identified:
        """The draws ``kept`` (k,)."""
        rate, noise = self.rate, self.rate.operation.pickoff_noise_v
        if isinstance(noise, np.ndarray):
            rate = replace(rate, operation=replace(rate.operation, pickoff_noise_v=noise[kept]))
        return Identified(self.physical[kept], self.split_hz[kept], rate)

    @property
    def draws(self) -> dict[str, FloatArray]:
        """Quantities (n,) by name, with common errors drawn where their sd is not 0."""
        if self.rate.systematic.exact:
            return quantities(self.physical, self.rate, self.split_hz)
        return self.given(common_nodes(self.physical.shape[0]))

    def given(self, z: FloatArray) -> dict[str, FloatArray]:
        """Quantities (..., n) if the common errors were z (..., n, 5) in standard deviations.

        Raises
        ------
        ConfigError : a phase error of 90 deg or more.
        """
        s = self.rate.systematic
        _, _, gain, clock, temperature = by_column(z) * np.array(s.sds).reshape(-1, *[1] * (z.ndim - 1))
        rates, stiffness = 1.0 + 1e-6 * clock, 1.0 + 1e-6 * s.tcf_ppm_per_c * temperature
        shape = np.broadcast_shapes(rates.shape, self.split_hz.shape)
        physical = np.broadcast_to(self.physical, (*shape, len(PHYSICAL))).copy()
        physical[..., _RATES] *= rates[..., None]
        physical[..., _FREQUENCIES] *= stiffness[..., None]
        physical[..., _DAMPINGS] /= stiffness[..., None]
        physical[..., _GAINS] *= np.exp(gain)[..., None]
        return quantities(physical, demodulated(self.rate, z), self.split_hz * rates * stiffness)


def common_factors(rate: RateSettings, z: FloatArray) -> dict[str, tuple[tuple[str, FloatArray], ...]]:
    """How the identified quantities follow from those without common errors: q -> ((u, a), ..), q(z) = sum of a u.

    Quantities that no common error moves are left out, and so are figures, which are no such sums.

    Parameters
    ----------
    rate : common errors and demodulation; without an angular gain the rate biases are left out.
    z : (K, 5) common errors [sd]; each a is (K,).
    """
    s = rate.systematic
    _, _, gain, clock, temperature = z.T * np.array(s.sds)[:, None]
    rates, stiffness = 1.0 + 1e-6 * clock, 1.0 + 1e-6 * s.tcf_ppm_per_c * temperature
    volts = rates * np.exp(gain)
    own = dict.fromkeys(("f1_hz", "f2_hz", "f3_hz", "split_hz"), rates * stiffness)
    own |= dict.fromkeys(("rocking_gain", "updown_gain"), volts) | {"c12_per_s": rates}
    own |= {f"zeta{i}": 1.0 / stiffness for i in (1, 2, 3)} | {f"quality{i}": stiffness for i in (1, 2, 3)}
    found: dict[str, tuple[tuple[str, FloatArray], ...]] = {name: ((name, factor),) for name, factor in own.items()}
    if rate.angular_gain is None:
        return found
    at = demodulated(rate, z)
    assert at.angular_gain is not None  # demodulated keeps it
    ratio = np.asarray(rate.angular_gain / at.angular_gain)
    # (w1^2 - w2^2) / w0 and the rates of damping, over the angular gain.
    quadrature, inphase = rates * stiffness * ratio, rates * ratio
    leaked = quadrature * np.tan(np.deg2rad(at.phase_error_deg))
    return found | {
        "quadrature_rate_dps": (("quadrature_rate_dps", quadrature),),
        "quadrature_bias_dps": (("quadrature_rate_dps", leaked),),
        "inphase_bias_dps": (("inphase_bias_dps", inphase),),
        "rate_bias_dps": (("quadrature_rate_dps", leaked), ("inphase_bias_dps", inphase)),
    }


def demodulated(rate: RateSettings, z: FloatArray) -> RateSettings:
    """The settings with phase error and angular gain (...) at the common errors z (..., 5) [sd]; raises as ``quantities``."""
    s = rate.systematic
    kappa = rate.angular_gain
    moved = None if kappa is None else kappa * np.exp(s.angular_gain_sd / kappa * z[..., 1])
    return replace(rate, angular_gain=moved, phase_error_deg=rate.phase_error_deg + s.phase_error_sd_deg * z[..., 0])


def rate_settings(campaign: Campaign) -> RateSettings:
    """Angular gain, demodulation, common errors and operation that a campaign declares."""
    instrument, operation = campaign.instrument, campaign.operation
    known = [r.temperature_c for r in campaign.with_role("fit") if r.temperature_c is not None]
    if operation.temperature_c is None and known:
        operation = replace(operation, temperature_c=float(np.mean(known)))
    return RateSettings(
        campaign.angular_gain,
        campaign.phase_error_deg,
        campaign.drive,
        campaign.systematic,
        operation,
        instrument.bias_v,
        instrument.pickoff,
    )


def common_shifts(physical: FloatArray, split_hz: FloatArray, rate: RateSettings) -> dict[str, FloatArray]:
    """What one sd of each common error does to each quantity: (5, B), with sign, to first order.

    Parameters
    ----------
    physical, split_hz : (B, 12) estimates and (B,) splits [Hz]; nan where unknown.
    rate : common errors and demodulation.
    """
    point = Identified(physical, split_hz, rate)
    plus, minus = (
        point.given(np.broadcast_to(sign * np.eye(_ERRORS)[:, None], (_ERRORS, *split_hz.shape, _ERRORS)))
        for sign in (1.0, -1.0)
    )
    return {name: (plus[name] - minus[name]) / 2.0 for name in plus}


def with_common_errors(
    estimates: Mapping[str, tuple[float, float]], systematic: Systematic
) -> dict[str, tuple[float, float]]:
    """name -> (value, sd), the sd combined with that of the common errors, to first order.

    Parameters
    ----------
    estimates : parameters of plant "gyro" or "modal" and split_hz, in their units; those of effects keep their sd.
    systematic : standard deviations of the common errors.
    """
    if systematic.exact:
        return dict(estimates)
    physical = np.array([[estimates.get(name, (1.0, 0.0))[0] for name in PHYSICAL]])
    split = np.array([estimates.get("split_hz", (1.0, 0.0))[0]])
    plus, minus = (
        Identified(physical, split, RateSettings(systematic=systematic)).given(sign * np.eye(_ERRORS))
        for sign in (1.0, -1.0)
    )
    out: dict[str, tuple[float, float]] = {}
    for name, (value, sd) in estimates.items():
        common = 0.0
        if name in plus:
            common = float(np.linalg.norm(plus[name] - minus[name])) / 2.0
        elif _MODAL_GAIN.fullmatch(name):
            common = abs(value) * systematic.gain_sd
        out[name] = value, float(np.hypot(sd, common))
    return out
