"""TOML tables that campaigns, modal records and run configurations share, with one range for each key.

Ranges: an ADC has 1 to 64 bits (a comparator to the widest integer of a record); a Butterworth filter has order 1 to 32,
twice the highest order of an analog filter in practice; a demodulation phase error lies between -90 and 90 deg, where its
tangent, which enters the rate bias, is finite.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import asdict

from ...errors import ConfigError
from ...performance.operating_point import DeclaredOperation
from ...quantities import NAMES
from ...toml_files import check_known
from ..instrument import Adc, AntiAlias, Hold, Instrument, Pickoff
from ..systematic import SILICON_TCF_PPM_PER_C, Systematic

#: Beyond 1e12 no quantity of a bench lies, in any of the units here; squares and products of larger numbers overflow.
Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e12)]
Value = Annotated[float, Meta(ge=-1e12, le=1e12)]
FilterOrder = Annotated[int, Meta(ge=1, le=32)]
AdcBits = Annotated[int, Meta(ge=1, le=64)]
PhaseError = Annotated[float, Meta(gt=-90.0, lt=90.0)]
StandardDeviation = Annotated[float, Meta(gt=0.0, le=1e12, description="an sd above 0")]
#: quantity -> [value, sd]
References = dict[str, tuple[Value, StandardDeviation]]


class AntiAliasTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The analog filter before the converter: ``order`` poles, -3 dB at ``corner_hz`` [Hz]."""

    order: FilterOrder
    corner_hz: Positive
    kind: Literal["butterworth"] = "butterworth"

    def built(self) -> AntiAlias:
        """The filter that this table describes."""
        return AntiAlias(self.kind, self.order, self.corner_hz)


class AdcTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The converter: ``bits`` over +- ``full_scale_v`` [V]."""

    bits: AdcBits
    full_scale_v: Positive

    def built(self) -> Adc:
        """The converter that this table describes."""
        return Adc(self.bits, self.full_scale_v)


class InstrumentTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The instrument [Hz, V].  ``antialias`` and ``adc`` that are absent or ``false``: none."""

    sample_rate_hz: Positive | None = None
    hold: Hold = "zoh"
    bias_v: Value = 5.0
    antialias: AntiAliasTable | Literal[False] | None = None
    adc: AdcTable | Literal[False] | None = None

    def built(self, sample_rate_hz: float) -> Instrument:
        """The instrument that this table describes, at ``sample_rate_hz`` [Hz]."""
        return Instrument(
            sample_rate_hz,
            self.hold,
            self.bias_v,
            self.antialias.built() if self.antialias else None,
            self.adc.built() if self.adc else None,
        )


class DeviceTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The device: its id, angular_gain = I_p / I_0p, and whether its pick-offs sense velocity or displacement.

    ``lot``, ``wafer``, ``package``, ``die_x_mm``, ``die_y_mm`` [mm from the centre of the wafer] say where it was made.
    """

    id: str = ""
    angular_gain: Positive | None = None
    pickoff: Pickoff = "velocity"
    lot: str = ""
    wafer: str = ""
    package: str = ""
    die_x_mm: Value | None = None
    die_y_mm: Value | None = None


class ConditionsTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Who measured what when, for gauge R&R: ``part`` is the device (left out: its id), for several campaigns of one device."""

    part: str = ""
    tester: str = ""
    session: str = ""


class DemodulationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Phase error of the demodulation [deg], and the mode whose frequency is omega_0."""

    phase_error_deg: PhaseError = 0.0
    drive: Literal["f1", "f2"] = "f1"


class SystematicTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Standard deviations of the errors that all devices of a tester or a session share; see :class:`Systematic`.

    At most 5 deg, 0.2, 0.2, 1000 ppm and 100 K: an error above that is a fault of the tester, not an uncertainty.
    """

    phase_error_sd_deg: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    angular_gain_sd: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.0
    gain_sd: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.0
    clock_sd_ppm: Annotated[float, Meta(ge=0.0, le=1000.0)] = 0.0
    temperature_sd_c: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0
    tcf_ppm_per_c: Annotated[float, Meta(ge=-1000.0, le=1000.0)] | None = None

    def built(self, tcf_ppm_per_c: float = SILICON_TCF_PPM_PER_C) -> Systematic:
        """The standard deviations; ``tcf_ppm_per_c`` [ppm/K] where the table states no temperature coefficient."""
        tcf = tcf_ppm_per_c if self.tcf_ppm_per_c is None else self.tcf_ppm_per_c
        return Systematic(**(asdict(self) | {"tcf_ppm_per_c": tcf}))


class OperationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """How the gyro is operated, for the performance figures; see :class:`DeclaredOperation`.  A missing key is unknown."""

    drive_amplitude_v: Positive | None = None
    pickoff_noise_v: Positive | None = None
    softening_hz_per_v2: Annotated[float, Meta(ge=-1000.0, lt=0.0)] | None = None
    gap_um: Positive | None = None
    mass_mg: Positive | None = None
    temperature_c: Annotated[float, Meta(ge=-273.15, le=1000.0)] | None = None
    damping_ppm_per_c: Annotated[float, Meta(ge=-1e5, le=1e5)] | None = None
    shock_ms: Positive | None = None

    def built(self) -> DeclaredOperation:
        """The operation that this table declares."""
        return DeclaredOperation(**asdict(self))


def check_phase(demodulation: DemodulationTable, systematic: SystematicTable, where: str) -> None:
    """Raise ConfigError unless the tangent of the phase error is finite for every error within 10 sd."""
    phase, sd = demodulation.phase_error_deg, systematic.phase_error_sd_deg
    if not abs(phase) + 10.0 * sd < 90.0:
        raise ConfigError(
            f"{where}: the demodulation phase error may reach 90 deg",
            value={"phase_error_deg": phase, "phase_error_sd_deg": sd},
            allowed="|phase_error_deg| + 10 phase_error_sd_deg below 90 deg",
            next_step="correct one of them",
        )


def references(table: References, where: str) -> dict[str, tuple[float, float]]:
    """[reference] as a dictionary; raises :class:`ConfigError` for a name that is no result quantity."""
    for name in table:
        check_known(name, NAMES, f"{where}: [reference]", "quantity")
    return dict(table)
