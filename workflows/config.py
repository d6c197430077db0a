"""The run configuration: a TOML of data, checked whole before anything runs.

Units are in the names of the keys.  What is left out has the default of the paper's experiment.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from pipeline.device.operation.trim import Target
from pipeline.device.operation.trim_electrodes import Electrodes, standard_electrodes
from pipeline.errors import ConfigError, MeasurementError
from pipeline.experiment.excitation import Chirp, Excitation, Multisine
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.noise.measure import Hum
from pipeline.inference.gate import Gate
from pipeline.inference.screening.sample import SamplerSettings
from pipeline.toml_files import converted, decode, read_text
from reports.limits import DEFAULT_LIMITS, Limits, load_limits

DEFAULT_CONFIG = Path(__file__).parent / "configs" / "default.toml"

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]


class RunTable(Struct, frozen=True, forbid_unknown_fields=True):
    """How many devices, from which seed, in blocks of how many, on how many workers (0: one a core)."""

    devices: Annotated[int, Meta(ge=1, le=10_000_000)] = 200
    seed: Annotated[int, Meta(ge=0)] = 1
    block: Annotated[int, Meta(ge=1, le=10_000)] = 25
    workers: Annotated[int, Meta(ge=0, le=1024)] = 0


class Source(Struct, frozen=True, forbid_unknown_fields=True):
    """A population (``spec``: a shipped name or a TOML path; ``values``: its named assumptions) or measured campaigns."""

    kind: Literal["population", "campaigns"] = "population"
    spec: str = "cloverleaf"
    values: dict[str, float] = {}
    path: str | None = None


class ExperimentTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The excitation, the silence before it, and effects that virtual devices have beside the model's own."""

    kind: Literal["chirp", "multisine"] = "chirp"
    start_hz: tuple[Positive, ...] = (400.0, 700.0)
    stop_hz: tuple[Positive, ...] = (700.0, 400.0)
    amplitude_v: tuple[NotNegative, ...] = (2.0, 2.0)
    duration_s: Annotated[float, Meta(gt=0.0, le=600.0)] = 3.0
    period_s: Positive = 3.0
    silence_s: Positive = 1.0
    effects: tuple[str, ...] = ()

    def excitation(self) -> Excitation:
        """The excitation that the table describes."""
        if self.kind == "chirp":
            return Chirp(self.start_hz, self.stop_hz, self.amplitude_v, self.duration_s)
        low = min(*self.start_hz, *self.stop_hz)
        high = max(*self.start_hz, *self.stop_hz)
        return Multisine(low, high, self.amplitude_v, self.duration_s, self.period_s)


class AntiAliasTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The analog filter in front of the converter."""

    kind: Literal["butterworth"] = "butterworth"
    order: Annotated[int, Meta(ge=1, le=16)] = 8
    corner_hz: Positive = 4800.0


class AdcTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The converter."""

    bits: Annotated[int, Meta(ge=2, le=32)] = 16
    full_scale_v: Positive = 10.0


class InstrumentTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The instrument; ``antialias = false`` and ``adc = false`` leave them out."""

    sample_rate_hz: Positive = 10_000.0
    hold: Literal["zoh", "foh", "bandlimited"] = "zoh"
    bias_v: float = 5.0
    antialias: AntiAliasTable | Literal[False] = AntiAliasTable()
    adc: AdcTable | Literal[False] = AdcTable()

    def instrument(self) -> Instrument:
        """The instrument that the table describes."""
        a, c = self.antialias, self.adc
        return Instrument(
            self.sample_rate_hz,
            self.hold,
            self.bias_v,
            AntiAlias(a.kind, a.order, a.corner_hz) if isinstance(a, AntiAliasTable) else None,
            Adc(c.bits, c.full_scale_v) if isinstance(c, AdcTable) else None,
        )


class NoiseTable(Struct, frozen=True, forbid_unknown_fields=True):
    """White noise: ``sigma_v`` volts, or ``snr_db`` = rms of the 2 s window over sigma, device by device."""

    sigma_v: Positive | None = None
    snr_db: float | None = None


class HumTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Mains hum: amplitudes of the harmonics 1, 2, .. of ``frequency_hz``; an empty list is no hum."""

    frequency_hz: Literal[50, 60] = 60
    amplitude_v: tuple[NotNegative, ...] = (0.005, 0.002, 0.003, 0.001, 0.002, 0.0005, 0.001, 0.0005, 0.0005)


class DemodulationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Phase error of the demodulation and the mode that sets omega_0."""

    phase_error_deg: Annotated[float, Meta(gt=-90.0, lt=90.0)] = 1.0
    drive: Literal["f1", "f2"] = "f1"


class IdentificationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The paper's route (order, window) and the band of the likelihood."""

    order: Annotated[int, Meta(ge=10, le=80)] = 40
    window_s: Positive = 2.0
    low_hz: Positive = 400.0
    high_hz: Positive = 700.0


class PosteriorTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Sizes of the emcee ensembles, when they count as converged, and how many draws a device are stored."""

    ensembles: Annotated[int, Meta(ge=4, le=64)] = 4
    walkers: Annotated[int, Meta(ge=24, le=4096)] = 96
    steps: Annotated[int, Meta(ge=4, le=100_000)] = 8
    rhat_max: Annotated[float, Meta(gt=1.0)] = 1.01
    ess_min: NotNegative = 1000.0
    stored_draws: Annotated[int, Meta(ge=0)] = 100

    def settings(self) -> SamplerSettings:
        """Settings of the sampler."""
        return SamplerSettings(self.ensembles, self.walkers, self.steps, rhat_max=self.rhat_max, ess_min=self.ess_min)


class GateTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The goodness-of-fit gate."""

    error_max: Positive = 1.1
    theta_bias_max_deg: Positive = 0.5

    def gate(self) -> Gate:
        """The gate that the table describes."""
        return Gate(self.error_max, self.theta_bias_max_deg)


class TrimTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Electronic tuning after the test: pairs of trim electrodes, and what they aim at; absent: no trim.

    ``softening_hz_per_v2`` is what a pair does to the mode along its azimuth, known to a relative sd of ``gain_sd``.
    """

    azimuth_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0)
    softening_hz_per_v2: Annotated[float, Meta(lt=0.0)] = -0.03
    gain_sd: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.05
    most_v: Positive = 15.0
    split_hz: NotNegative | None = 0.0
    theta_deg: float | None = None

    def electrodes(self) -> Electrodes:
        """The electrodes that the table describes."""
        return standard_electrodes(self.azimuth_deg, self.softening_hz_per_v2, gain_sd=self.gain_sd, most_v=self.most_v)

    def target(self) -> Target:
        """What the trim aims at."""
        return Target(self.split_hz, self.theta_deg)


class EffectTable(Struct, frozen=True, forbid_unknown_fields=True):
    """An effect that virtual devices have and the screening model may lack: a rehearsal of such a night.

    ``size``: parameter -> mean and sd of a normal distribution over the devices that carry it, cut at the effect's range.
    Carriers: ``share`` of the devices, or those named in ``devices``; only in ``lots``, where some are named.
    """

    size: dict[str, tuple[float, NotNegative]]
    share: Share = 1.0
    devices: tuple[str, ...] = ()
    lots: tuple[str, ...] = ()


class DiagnosisTable(Struct, frozen=True, forbid_unknown_fields=True):
    """What is asked of misfits after the last block.

    At most ``most`` flagged devices are examined, and ``sample`` of those that are ok (absent: a fiftieth of the run, 4 at
    least), so that an effect too weak to flag a single one is found; ``alpha`` is the family-wise probability of naming one
    where there is none.
    """

    enabled: bool = True
    most: Annotated[int, Meta(ge=1)] = 200
    sample: Annotated[int, Meta(ge=0)] | None = None
    alpha: Annotated[float, Meta(gt=0.0, lt=0.5)] = 0.003


class Targets(Struct, frozen=True, forbid_unknown_fields=True):
    """Gates on the whole run: they set the exit code 1, nothing else."""

    yield_min: Share | None = None
    strict_convergence: bool = False


class RunConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The whole run; ``rule`` and ``limits`` are checked by :func:`reports.limits.load_limits`."""

    run: RunTable = RunTable()
    source: Source = Source()
    experiment: ExperimentTable = ExperimentTable()
    instrument: InstrumentTable = InstrumentTable()
    noise: NoiseTable = NoiseTable()
    hum: HumTable = HumTable()
    demodulation: DemodulationTable = DemodulationTable()
    identification: IdentificationTable = IdentificationTable()
    posterior: PosteriorTable = PosteriorTable()
    gate: GateTable = GateTable()
    targets: Targets = Targets()
    trim: TrimTable | None = None
    effects: dict[str, EffectTable] = {}
    diagnosis: DiagnosisTable = DiagnosisTable()
    rule: dict[str, Any] = {}
    limits: dict[str, Any] = {}

    def judged_by(self) -> Limits:
        """Limits and rule; the shipped ones where the file has no [limits]."""
        if not self.limits:
            if not self.rule:
                return DEFAULT_LIMITS
            judged = load_limits({"rule": self.rule, "limits": _as_table(DEFAULT_LIMITS)})
            return Limits(judged.rule, DEFAULT_LIMITS.limits)
        return load_limits({"rule": self.rule, "limits": self.limits} if self.rule else {"limits": self.limits})

    def hum_source(self) -> Hum:
        """Hum that virtual records get."""
        return Hum(float(self.hum.frequency_hz), self.hum.amplitude_v)

    def line_hz(self) -> float | None:
        """Fundamental of the hum lines that the model carries, or ``None``."""
        return float(self.hum.frequency_hz) if self.hum.amplitude_v else None


def _as_table(limits: Limits) -> dict[str, dict[str, float]]:
    finite = {}
    for limit in limits.limits:
        bounds = {"min": limit.low, "max": limit.high}
        finite[limit.quantity] = {k: v for k, v in bounds.items() if abs(v) != float("inf")}
    return finite


def load_config(path: Path | None, overrides: dict[str, Any] | None = None) -> RunConfig:
    """The configuration in ``path`` (``None``: the shipped default), [run] keys overridden by ``overrides``.

    Raises
    ------
    ConfigError : anything in it cannot be run; nothing has run by then.
    """
    source = path or DEFAULT_CONFIG
    try:
        text = read_text(source)
    except MeasurementError as error:
        raise ConfigError(error.what, value=error.value, next_step=error.next_step) from None
    config = decode(text, RunConfig, source.name)
    changed = msgspec.to_builtins(config.run) | (overrides or {})
    config = msgspec.structs.replace(config, run=converted(changed, RunTable, "[run]"))
    _check(config)
    return config


def _check(config: RunConfig) -> None:
    e, i, noise = config.experiment, config.identification, config.noise
    if not len(e.start_hz) == len(e.stop_hz) == len(e.amplitude_v) == 2:
        raise ConfigError(
            "[experiment] needs start_hz, stop_hz and amplitude_v for both drives",
            value=[list(e.start_hz), list(e.stop_hz), list(e.amplitude_v)],
            allowed="two values each",
        )
    if not any(e.amplitude_v):
        raise ConfigError("[experiment] drives nothing", value=list(e.amplitude_v), allowed="an amplitude above 0 V")
    nyquist = config.instrument.sample_rate_hz / 2.0
    if not i.low_hz < i.high_hz <= nyquist:
        raise ConfigError(
            "limits crossed in [identification]",
            value=[i.low_hz, i.high_hz],
            allowed=f"low_hz < high_hz <= {nyquist:g} Hz",
            next_step="swap low_hz and high_hz",
        )
    if noise.sigma_v is not None and noise.snr_db is not None:
        raise ConfigError("[noise] is given twice", value=[noise.sigma_v, noise.snr_db], allowed="sigma_v or snr_db")
    if config.instrument.hold == "bandlimited":
        raise ConfigError(
            "a run has no closed form for this hold", value="bandlimited", allowed="zoh, foh", next_step="set hold"
        )
    if config.source.kind == "campaigns" and config.source.path is None:
        raise ConfigError('[source] kind = "campaigns" needs a path', allowed="a folder of campaign folders")
    config.judged_by()
    if config.trim is not None:
        config.trim.electrodes()
        config.trim.target()


def to_struct_from_toml(text: str, where: str) -> RunConfig:
    """The configuration that a run kept as its run.toml.

    Raises
    ------
    ConfigError : it was edited into something that cannot be run.
    """
    return decode(text.encode(), RunConfig, where)


def to_toml_table(config: RunConfig) -> dict[str, Any]:
    """The configuration as plain data, defaults filled in."""
    plain: dict[str, Any] = msgspec.to_builtins(config)
    return plain
