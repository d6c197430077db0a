"""The nominal device, its wafer and its operating point: data only, as a population TOML states them.

Units are in the names; every field carries its range, which msgspec checks.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
Fraction = Annotated[float, Meta(ge=0.0, lt=1.0)]
Count = Annotated[int, Meta(ge=1, le=1000)]


class NominalDevice(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The device as designed, at ``nominal_bias_v``, ``nominal_temperature_c`` and ``nominal_pressure_pa``.

    Shapes below: J springs.  x, y are the axes of the paper's Figure 2; electrodes sit on the diagonals.
    """

    rocking_hz: Positive  # f0, both rocking modes
    updown_hz: Positive  # f3
    rocking_gain_per_s: Positive  # l^2 K_S K_D / I_0p
    updown_gain_per_s: Positive  # K_S K_D / m
    angular_gain: Annotated[float, Meta(gt=0.0, le=2.0)]  # kappa = I_p / I_0p
    quality_rocking: Positive  # total Q of the rocking modes at the nominal pressure
    quality_updown: Positive  # total Q of the up-down mode at the nominal pressure
    quality_anchor: Positive  # anchor loss alone, all modes
    quality_thermoelastic: Positive  # thermoelastic loss alone, all modes
    spring_azimuth_deg: Annotated[tuple[float, ...], Meta(min_length=2, max_length=32)]  # (J,)
    spring_width_um: Positive
    crystal_angle_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]  # the x axis from <100> on a (100) wafer
    arm_mm: Positive  # l, from the centre to the electrode along x and y
    post_mass_fraction: Fraction  # mass of the post over mass of the moving part
    softening_hz_per_v2: Annotated[float, Meta(ge=-10.0, le=0.0)]  # shift of f0 by both drive electrodes
    nominal_bias_v: Positive
    nominal_temperature_c: Annotated[float, Meta(ge=-200.0, le=400.0)]
    nominal_pressure_pa: Positive

    @property
    def lever(self) -> float:
        """mu = m l^2 / I_0p = rocking gain / up-down gain."""
        return self.rocking_gain_per_s / self.updown_gain_per_s

    @property
    def spring_radius(self) -> float:
        """r / l from (f_rocking / f_updown)^2 = m r^2 / (2 I_0p): the same springs carry both modes."""
        return math.sqrt(2.0 / self.lever) * self.rocking_hz / self.updown_hz


class Wafer(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wafer and the order in which its dies become devices."""

    diameter_mm: Positive
    pitch_mm: Positive
    edge_exclusion_mm: Annotated[float, Meta(ge=0.0, le=1000.0)]  # of die centres
    lots_per_batch: Count
    wafers_per_lot: Count


class Operating(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the packaged device runs, and the vacuum in which the wafer prober saw the bare die."""

    bias_v: Positive
    temperature_c: Annotated[float, Meta(ge=-200.0, le=400.0)]
    lid_pressure_pa: Positive
    probe_pressure_pa: Positive
