"""The nominal device, its wafer and its operating point, as a population file states them.

The unit of a field is the end of its name; ranges are checked when the file is read.  Shapes: J springs.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from pipeline.toml_keys import Meaning

Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
Fraction = Annotated[float, Meta(ge=0.0, lt=1.0)]
Count = Annotated[int, Meta(ge=1, le=1000)]


class NominalDevice(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The device as designed, at ``nominal_bias_v``, ``nominal_temperature_c`` and ``nominal_pressure_pa``.

    Units: [Hz], [1/s], [V], [degC], [Pa], [deg], [mm], [um], by the ends of the names.  x and y are the axes of the paper's
    Figure 2; the electrodes lie on the diagonals.
    """

    rocking_hz: Annotated[Positive, Meaning("f0, both rocking modes")]
    updown_hz: Annotated[Positive, Meaning("f3")]
    rocking_gain_per_s: Annotated[Positive, Meaning("l^2 K_S K_D / I_0p")]
    updown_gain_per_s: Annotated[Positive, Meaning("K_S K_D / m")]
    angular_gain: Annotated[float, Meta(gt=0.0, le=2.0), Meaning("kappa = I_p / I_0p", "1")]
    quality_rocking: Annotated[Positive, Meaning("total Q of the rocking modes, at the nominal pressure", "1")]
    quality_updown: Annotated[Positive, Meaning("total Q of the up-down mode, at the nominal pressure", "1")]
    quality_anchor: Annotated[Positive, Meaning("Q of the anchor loss alone, all modes", "1")]
    quality_thermoelastic: Annotated[Positive, Meaning("Q of the thermoelastic loss alone, all modes", "1")]
    spring_azimuth_deg: Annotated[
        tuple[float, ...], Meta(min_length=2, max_length=32), Meaning("(J,) of the springs, from the x axis")
    ]
    spring_width_um: Annotated[Positive, Meaning("of each spring")]
    crystal_angle_deg: Annotated[float, Meta(ge=-90.0, le=90.0), Meaning("from <100> to the x axis, on a (100) wafer")]
    arm_mm: Annotated[Positive, Meaning("l, distance of the electrodes from the centre along x and y")]
    post_mass_fraction: Annotated[Fraction, Meaning("mass of the post over that of the moving part", "1")]
    softening_hz_per_v2: Annotated[
        float, Meta(ge=-10.0, le=0.0), Meaning("shift of f0 by both drive electrodes together")
    ]
    nominal_bias_v: Annotated[Positive, Meaning("at which the frequencies and gains above hold")]
    nominal_temperature_c: Annotated[float, Meta(ge=-200.0, le=400.0), Meaning("at which the frequencies above hold")]
    nominal_pressure_pa: Annotated[Positive, Meaning("at which the Q above hold")]

    @property
    def lever(self) -> float:
        """mu = m l^2 / I_0p = rocking gain / up-down gain."""
        return self.rocking_gain_per_s / self.updown_gain_per_s

    @property
    def spring_radius(self) -> float:
        """r / l from (f_rocking / f_updown)^2 = m r^2 / (2 I_0p), because the same springs act on both modes."""
        return math.sqrt(2.0 / self.lever) * self.rocking_hz / self.updown_hz


class Wafer(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wafer, and the number of wafers and lots of a batch."""

    diameter_mm: Annotated[Positive, Meaning("of the wafer")]
    pitch_mm: Annotated[Positive, Meaning("distance of neighbouring dies, along x and y")]
    edge_exclusion_mm: Annotated[float, Meta(ge=0.0, le=1000.0), Meaning("of die centres")]
    lots_per_batch: Annotated[Count, Meaning("lots that are sampled in turn", "1")]
    wafers_per_lot: Annotated[Count, Meaning("wafers that are sampled of each lot", "1")]


class Operating(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Operating point of the packaged device [V, degC, Pa], and the pressure in the wafer prober [Pa]."""

    bias_v: Annotated[Positive, Meaning("on the drive electrodes of the packaged device")]
    temperature_c: Annotated[float, Meta(ge=-200.0, le=400.0), Meaning("of the packaged device, on average")]
    lid_pressure_pa: Annotated[Positive, Meaning("under a tight lid, on average")]
    probe_pressure_pa: Annotated[Positive, Meaning("in the wafer prober")]
