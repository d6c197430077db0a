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
from ...toml_keys import Meaning
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
References = Annotated[
    dict[str, tuple[Value, StandardDeviation]],
    Meaning(
        "quantity = [value, sd]: values of another instrument, which the posterior is compared with",
        "that of the quantity",
    ),
]


class AntiAliasTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The analog filter before the converter: ``order`` poles, -3 dB at ``corner_hz`` [Hz]."""

    order: Annotated[FilterOrder, Meaning("number of poles", "1")]
    corner_hz: Annotated[Positive, Meaning("frequency of -3 dB")]
    kind: Annotated[Literal["butterworth"], Meaning("family of the filter")] = "butterworth"

    def built(self) -> AntiAlias:
        """The filter that this table describes."""
        return AntiAlias(self.kind, self.order, self.corner_hz)


class AdcTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The converter: ``bits`` over +- ``full_scale_v`` [V]."""

    bits: Annotated[AdcBits, Meaning("resolution of the converter", "bits")]
    full_scale_v: Annotated[Positive, Meaning("range of the converter is +- this value")]

    def built(self) -> Adc:
        """The converter that this table describes."""
        return Adc(self.bits, self.full_scale_v)


class InstrumentTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The instrument [Hz, V].  ``antialias`` and ``adc`` that are absent or ``false``: none."""

    sample_rate_hz: Annotated[
        Positive | None, Meaning("sample rate of all records; absent: from the time column of the first record")
    ] = None
    hold: Annotated[
        Hold,
        Meaning(
            "how drive samples become volts: zoh holds each, foh connects them by lines, bandlimited has no images"
        ),
    ] = "zoh"
    bias_v: Annotated[Value, Meaning("bias of the drive electrodes, which the drive columns do not contain")] = 5.0
    antialias: Annotated[
        AntiAliasTable | Literal[False] | None, Meaning("analog filter before the converter; absent or false: none")
    ] = None
    adc: Annotated[
        AdcTable | Literal[False] | None, Meaning("converter; absent or false: its rounding is not modelled")
    ] = None

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

    id: Annotated[str, Meaning("name of the device; absent: the folder")] = ""
    angular_gain: Annotated[Positive | None, Meaning("I_p / I_0p, needed for biases in deg/s", "1")] = None
    pickoff: Annotated[Pickoff, Meaning("what the pick-offs sense")] = "velocity"
    lot: Annotated[str, Meaning("lot that the device was made in")] = ""
    wafer: Annotated[str, Meaning("wafer that the device was made on")] = ""
    package: Annotated[str, Meaning("package that the device is in")] = ""
    die_x_mm: Annotated[Value | None, Meaning("place on the wafer, from its centre", "mm")] = None
    die_y_mm: Annotated[Value | None, Meaning("place on the wafer, from its centre", "mm")] = None


class ConditionsTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Who measured what when, for gauge R&R: ``part`` is the device (left out: its id), for several campaigns of one device."""

    part: Annotated[str, Meaning("device that is measured repeatedly; absent: its id")] = ""
    tester: Annotated[str, Meaning("tester that measured")] = ""
    session: Annotated[str, Meaning("session in which it was measured")] = ""


class DemodulationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Phase error of the demodulation [deg], and the mode whose frequency is omega_0."""

    phase_error_deg: Annotated[
        PhaseError, Meaning("phase error of the demodulation, which turns quadrature into a rate bias")
    ] = 0.0
    drive: Annotated[Literal["f1", "f2"], Meaning("mode that is driven, whose frequency is omega_0")] = "f1"


class SystematicTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Standard deviations of the errors that all devices of a tester or a session share; see :class:`Systematic`.

    At most 5 deg, 0.2, 0.2, 1000 ppm and 100 K: an error above that is a fault of the tester, not an uncertainty.
    """

    phase_error_sd_deg: Annotated[float, Meta(ge=0.0, le=5.0), Meaning("sd of the demodulation phase error")] = 0.0
    angular_gain_sd: Annotated[float, Meta(ge=0.0, le=0.2), Meaning("sd of the angular gain", "1")] = 0.0
    gain_sd: Annotated[
        float, Meta(ge=0.0, le=0.2), Meaning("relative sd of the gain from drive volts to pick-off volts", "1")
    ] = 0.0
    clock_sd_ppm: Annotated[float, Meta(ge=0.0, le=1000.0), Meaning("relative sd of the sample rate")] = 0.0
    temperature_sd_c: Annotated[
        float, Meta(ge=0.0, le=100.0), Meaning("sd of the temperature during the test", "K")
    ] = 0.0
    tcf_ppm_per_c: Annotated[
        Annotated[float, Meta(ge=-1000.0, le=1000.0)] | None,
        Meaning(
            "temperature coefficient of the mode frequencies; absent: -28, that of silicon, or that of the population"
        ),
    ] = None

    def built(self, tcf_ppm_per_c: float = SILICON_TCF_PPM_PER_C) -> Systematic:
        """The standard deviations; ``tcf_ppm_per_c`` [ppm/K] where the table states no temperature coefficient."""
        tcf = tcf_ppm_per_c if self.tcf_ppm_per_c is None else self.tcf_ppm_per_c
        return Systematic(**(asdict(self) | {"tcf_ppm_per_c": tcf}))


class OperationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """How the gyro is operated, for the performance figures; see :class:`DeclaredOperation`.  A missing key is unknown."""

    drive_amplitude_v: Annotated[
        Positive | None,
        Meaning("amplitude of the driven mode in the blend of pick-offs that shows it: S1 + S2 for rocking about y"),
    ] = None
    pickoff_noise_v: Annotated[
        Positive | None,
        Meaning(
            "one-sided noise density of each pick-off at the drive frequency; absent: that of the silent record",
            "V/sqrt(Hz)",
        ),
    ] = None
    softening_hz_per_v2: Annotated[
        Annotated[float, Meta(ge=-1000.0, lt=0.0)] | None,
        Meaning("shift of the rocking modes by the bias on both drive electrodes, negative"),
    ] = None
    gap_um: Annotated[Positive | None, Meaning("gap of the drive electrodes at the bias")] = None
    mass_mg: Annotated[Positive | None, Meaning("effective mass of rocking at an electrode, I_0p / l^2")] = None
    temperature_c: Annotated[
        Annotated[float, Meta(ge=-273.15, le=1000.0)] | None, Meaning("temperature of the device in operation")
    ] = None
    damping_ppm_per_c: Annotated[
        Annotated[float, Meta(ge=-1e5, le=1e5)] | None, Meaning("temperature coefficient of the damping rates")
    ] = None
    shock_ms: Annotated[Positive | None, Meaning("duration of a half-sine shock along z")] = None

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
