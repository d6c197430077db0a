"""The tables of a run configuration, each with its defaults: those of the paper's experiment.

Units are the ends of the keys' names.  Tables of the instrument and of the demodulation extend those that campaigns use;
the ranges are the same, and a key that is left out has the paper's value.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from pipeline.device.operation.trim import Target
from pipeline.device.operation.trim_electrodes import Electrodes, standard_electrodes
from pipeline.experiment.excitation import Chirp, Excitation, Multisine
from pipeline.experiment.files.common_tables import (
    AdcBits,
    AdcTable,
    AntiAliasTable,
    DemodulationTable,
    FilterOrder,
    InstrumentTable,
    NotNegative,
    PhaseError,
    Positive,
    Value,
)
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.source import Kind, NoiseKind
from pipeline.inference.gate import Gate
from pipeline.inference.screening.sample import SamplerSettings
from pipeline.toml_files import MAY_BE_INFINITE
from reports.limits import BoundsTable, Limits

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
#: Mean and sd of a parameter of an effect; the largest range of one ends at 1e15.
EffectSize = Annotated[float, Meta(ge=-1e30, le=1e30)]
EffectSpread = Annotated[float, Meta(ge=0.0, le=1e30)]
#: An upper limit of something; inf switches it off.
Threshold = Annotated[float, Meta(gt=0.0, extra=MAY_BE_INFINITE)]
#: Quantities whose bias by an undetected effect the gate judges, where they have limits.
GATED = (
    "theta_deg", "split_hz", "zeta1", "zeta2", "zeta3", "quality1", "quality2", "quality3", "c12_per_s", "rate_bias_dps"
)  # fmt: skip


class RunTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Number of devices, seed, devices per block, and workers (0: one per core).

    ``device_limit_s`` is the time limit of a device [s]; absent: 20 times the median, at least 60 s.
    """

    devices: Annotated[int, Meta(ge=1, le=10_000_000)] = 200
    seed: Annotated[int, Meta(ge=0)] = 1
    block: Annotated[int, Meta(ge=1, le=10_000)] = 25
    workers: Annotated[int, Meta(ge=0, le=1024)] = 0
    device_limit_s: Positive | None = None


class SourceTable(Struct, frozen=True, forbid_unknown_fields=True):
    """A population (``spec``: a shipped name or a TOML file; ``values``: its named assumptions), or measured campaigns.

    ``path`` is the folder that contains the campaign folders.  Paths are relative to the configuration file.  ``spec_toml`` is
    the text of the population, which a run writes into its run.toml; it takes precedence over ``spec``.
    ``store_irregularities``: keep the random numbers of each virtual device in the table ``irregularities``.
    """

    kind: Literal["population", "campaigns"] = "population"
    spec: str = "cloverleaf"
    spec_toml: str | None = None
    values: dict[str, float] = {}
    path: str | None = None
    store_irregularities: bool = True


class ExperimentTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The excitation, the silent record before it, and the effects with sizes drawn by the population that virtual devices have.

    The default has all linear ones.  The nightly model fits electrode mismatches if one of these two effects is named.
    One start, stop [Hz] and amplitude [V] for each drive; ``period_s`` [s] is that of the multisine.
    """

    kind: Literal["chirp", "multisine"] = "chirp"
    start_hz: tuple[Positive, ...] = (400.0, 700.0)
    stop_hz: tuple[Positive, ...] = (700.0, 400.0)
    amplitude_v: tuple[NotNegative, ...] = (2.0, 2.0)
    duration_s: Annotated[float, Meta(gt=0.0, le=600.0)] = 3.0
    period_s: Positive = 3.0
    silence_s: Positive = 1.0
    effects: tuple[str, ...] = ("electrode_mismatch", "updown_tilt")

    def excitation(self) -> Excitation:
        """The excitation that the table describes."""
        if self.kind == "chirp":
            return Chirp(self.start_hz, self.stop_hz, self.amplitude_v, self.duration_s)
        low = min(*self.start_hz, *self.stop_hz)
        high = max(*self.start_hz, *self.stop_hz)
        return Multisine(low, high, self.amplitude_v, self.duration_s, self.period_s)


class RunAntiAliasTable(AntiAliasTable, frozen=True, forbid_unknown_fields=True):
    """The analog filter before the converter; the default is the paper's."""

    order: FilterOrder = 8
    corner_hz: Positive = 4800.0


class RunAdcTable(AdcTable, frozen=True, forbid_unknown_fields=True):
    """The converter; the default is the paper's."""

    bits: AdcBits = 16
    full_scale_v: Positive = 10.0


class RunInstrumentTable(InstrumentTable, frozen=True, forbid_unknown_fields=True):
    """The instrument; the default is the paper's.  ``antialias = false`` and ``adc = false``: none."""

    sample_rate_hz: Positive = 10_000.0
    antialias: RunAntiAliasTable | Literal[False] = RunAntiAliasTable()
    adc: RunAdcTable | Literal[False] = RunAdcTable()

    def instrument(self) -> Instrument:
        """The instrument that the table describes."""
        return self.built(self.sample_rate_hz)


class NoiseTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Noise level: sigma [V], or the SNR [dB] of each device (rms of the signal in the window over sigma); and its kind.

    ``coefficient`` belongs to "ar", ``corner_hz`` to "1/f", ``jitter_s`` to "jitter", ``gain_noise`` to "gain"; sigma of "1/f" is
    that of its white part.
    """

    sigma_v: Positive | None = None
    snr_db: Annotated[float, Meta(ge=-400.0, extra=MAY_BE_INFINITE)] | None = None
    kind: Kind = "white"
    coefficient: Annotated[float, Meta(gt=-1.0, lt=1.0)] = 0.7
    corner_hz: NotNegative = 1000.0
    jitter_s: NotNegative = 3e-7
    gain_noise: NotNegative = 1e-3

    def noise_kind(self) -> NoiseKind:
        """The kind of noise that the table describes."""
        return NoiseKind(self.kind, self.coefficient, self.corner_hz, self.jitter_s, self.gain_noise)


class HumTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Mains hum: amplitudes [V] of the harmonics 1, 2, .. of ``frequency_hz`` [Hz]; an empty list means no hum."""

    frequency_hz: Literal[50, 60] = 60
    amplitude_v: tuple[NotNegative, ...] = (0.005, 0.002, 0.003, 0.001, 0.002, 0.0005, 0.001, 0.0005, 0.0005)


class RunDemodulationTable(DemodulationTable, frozen=True, forbid_unknown_fields=True):
    """Phase error of the demodulation, and the mode whose frequency is omega_0."""

    phase_error_deg: PhaseError = 1.0


class IdentificationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """ARX order and window [s] of the paper's route, and the band [Hz] of the likelihood."""

    order: Annotated[int, Meta(ge=10, le=80)] = 40
    window_s: Positive = 2.0
    low_hz: Positive = 400.0
    high_hz: Positive = 700.0


class PosteriorTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Size of the emcee ensembles, criteria of convergence, and the number of stored draws per device."""

    ensembles: Annotated[int, Meta(ge=4, le=64)] = 4
    walkers: Annotated[int, Meta(ge=24, le=4096)] = 96
    steps: Annotated[int, Meta(ge=4, le=100_000)] = 8
    rhat_max: Annotated[float, Meta(gt=1.0, extra=MAY_BE_INFINITE)] = 1.01
    ess_min: NotNegative = 1000.0
    stored_draws: Annotated[int, Meta(ge=0)] = 100

    def settings(self) -> SamplerSettings:
        """Settings of the sampler."""
        return SamplerSettings(self.ensembles, self.walkers, self.steps, rhat_max=self.rhat_max, ess_min=self.ess_min)


class GateTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The gate: largest error [sigma], largest bound on the bias of theta [deg], and what undetected effects may do.

    ``bias_fraction`` is the largest bias that an undetected effect may cause, as a share of the width of the limits of a
    quantity: a bias of 5 % of the width changes the verdict of 5 % of devices that are spread over it.  ``effect_alpha`` is
    the probability that an effect is found in a device that has none.
    """

    error_max: Threshold = 1.1
    theta_bias_max_deg: Threshold = 0.5
    bias_fraction: Threshold = 0.05
    effect_alpha: Annotated[float, Meta(ge=0.0, lt=1.0)] = 1e-3

    def gate(self, limits: Limits) -> Gate:
        """The gate that the table describes, for devices that are judged by ``limits``."""
        widths = {limit.quantity: limit.width for limit in limits.limits if limit.quantity in GATED}
        bias_max = {quantity: self.bias_fraction * width for quantity, width in widths.items()}
        return Gate(self.error_max, self.theta_bias_max_deg, bias_max, self.effect_alpha)


class TrimTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Electrostatic trim after the test: pairs of trim electrodes and the target; without the table there is no trim.

    ``softening_hz_per_v2`` is the shift [Hz/V^2] of the mode along the azimuth of a pair, ``gain_sd`` its relative sd.
    """

    azimuth_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0)
    softening_hz_per_v2: Annotated[float, Meta(lt=0.0)] = -0.03
    gain_sd: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.05
    most_v: Threshold = 15.0
    split_hz: NotNegative | None = 0.0
    theta_deg: Value | None = None

    def electrodes(self) -> Electrodes:
        """The electrodes that the table describes."""
        return standard_electrodes(self.azimuth_deg, self.softening_hz_per_v2, gain_sd=self.gain_sd, most_v=self.most_v)

    def target(self) -> Target:
        """The split and theta that the trim aims at."""
        return Target(self.split_hz, self.theta_deg)


class EffectTable(Struct, frozen=True, forbid_unknown_fields=True):
    """An effect that virtual devices have, whether or not the screening model contains it.

    ``size``: parameter -> mean and sd of a normal distribution over the affected devices, clipped to the effect's range.
    Affected are a ``share`` of the devices, or the ids in ``devices``; if ``lots`` is given, only in those lots.
    """

    size: dict[str, tuple[EffectSize, EffectSpread]]
    share: Share = 1.0
    devices: tuple[str, ...] = ()
    lots: tuple[str, ...] = ()


class DiagnosisTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The examination of misfits after the last block.

    At most ``most`` devices with status misfit are examined, and ``sample`` devices with status ok (absent: 2 % of them, at
    least 12), so that an effect that is too weak to flag any single device can be found.  ``alpha`` is the family-wise
    probability of a false detection.
    """

    enabled: bool = True
    most: Annotated[int, Meta(ge=1)] = 200
    sample: Annotated[int, Meta(ge=0)] | None = None
    alpha: Annotated[float, Meta(gt=0.0, lt=0.5)] = 0.003


class LotOriginTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The questions at the end of a night over measured campaigns: is the lot a draw from the population, and did it drift?

    ``population`` is the one that is used for screening: a shipped name or a TOML file; ``population_toml`` is its text, which a
    run writes into its run.toml.  ``false_alarm`` is the probability of a wrong "no" to each question; up to ``nights`` earlier
    nights are looked at.
    """

    enabled: bool = True
    population: str = "cloverleaf"
    population_toml: str | None = None
    false_alarm: Annotated[float, Meta(gt=0.0, lt=0.5)] = 0.01
    nights: Annotated[int, Meta(ge=0, le=100)] = 10


class TargetsTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Gates on the whole run.  A gate that fails sets the exit code 1 and has no other effect."""

    yield_min: Share | None = None
    strict_convergence: bool = False


class SamplingTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Sampling towards rare losses: ``gyroscreen rare``.

    ``limits`` are the limited quantities whose loss is estimated (absent: all), from at most ``devices`` virtual devices.  A loss
    is decided if the half-width of its 95 % interval is at most ``precision`` of it.  ``method`` "plain" draws the devices of the
    population instead, to compare.
    """

    limits: tuple[str, ...] = ()
    devices: Annotated[int, Meta(ge=1, le=100_000_000)] = 20_000
    precision: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.2
    method: Literal["importance", "plain"] = "importance"


class TrendTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Alarms of `gyroscreen report --against`, which set the exit code 1.

    ``false_alarm`` is the probability that a night in control raises any alarm of the control charts (absent: they are drawn, and
    decide nothing); ``limits`` bound the yield of a night, "yield", and means of its quantities.
    """

    false_alarm: Annotated[float, Meta(gt=0.0, lt=0.5)] | None = None
    limits: dict[str, BoundsTable] = {}
