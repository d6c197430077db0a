"""The run configuration: a TOML file that is checked completely before anything runs.

Units are the ends of the keys' names.  A key that is left out has the value of the paper's experiment.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Struct

from pipeline.errors import ConfigError
from pipeline.experiment.files.common_tables import OperationTable, SystematicTable, check_phase
from pipeline.experiment.noise.measure import Hum
from pipeline.inference.gate import Gate
from pipeline.input_limits import RECORD_VALUES
from pipeline.performance.figure import by_table, find_figures
from pipeline.performance.operating_point import OperatingPoint
from pipeline.toml_files import check_known, converted, decode, load
from pipeline.toml_keys import Meaning
from reports.limits import DEFAULT_LIMITS, BoundsTable, Limits, bounds_of, checked_limits
from reports.rules import RuleName, RuleTable
from reports.trend.charted import night_limits

from .config_bench import ExperimentTable, HumTable, NoiseTable, RunDemodulationTable, RunInstrumentTable
from .config_tables import (
    DiagnosisTable,
    EffectTable,
    GateTable,
    IdentificationTable,
    LotOriginTable,
    PosteriorTable,
    RunTable,
    SamplingTable,
    SourceTable,
    TargetsTable,
    TrendTable,
    TrimTable,
)

#: The 2.5 % tail of a yield interval then consists of two values or more of the common errors.
LEAST_STORED_DRAWS = 100
DEFAULT_CONFIG = Path(__file__).parent / "configs" / "default.toml"

#: Columns of a virtual record: time, two drives, two senses.
_COLUMNS = 5


class RunConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The configuration of a run."""

    run: Annotated[RunTable, Meaning("devices, seed and workers")] = RunTable()
    source: Annotated[SourceTable, Meaning("where the devices come from")] = SourceTable()
    experiment: Annotated[ExperimentTable, Meaning("excitation of virtual devices")] = ExperimentTable()
    instrument: Annotated[RunInstrumentTable, Meaning("hold, bias, filter and converter")] = RunInstrumentTable()
    noise: Annotated[NoiseTable, Meaning("noise of virtual records")] = NoiseTable()
    hum: Annotated[HumTable, Meaning("mains hum of virtual records")] = HumTable()
    demodulation: Annotated[RunDemodulationTable, Meaning("how the rate signal is demodulated")] = (
        RunDemodulationTable()
    )
    systematic: Annotated[SystematicTable, Meaning("errors that all devices of a tester share")] = SystematicTable()
    operation: Annotated[OperationTable, Meaning("how the gyro is operated")] = OperationTable()
    effect_folders: Annotated[tuple[str, ...], Meaning("folders with your own effects, relative to the file")] = ()
    identification: Annotated[IdentificationTable, Meaning("band and window of the identification")] = (
        IdentificationTable()
    )
    posterior: Annotated[PosteriorTable, Meaning("sampler and stored draws")] = PosteriorTable()
    gate: Annotated[GateTable, Meaning("what a fit must satisfy")] = GateTable()
    targets: Annotated[TargetsTable, Meaning("gates on the whole run")] = TargetsTable()
    trend: Annotated[TrendTable, Meaning("alarms of night against night")] = TrendTable()
    trim: Annotated[TrimTable | None, Meaning("electrostatic trim after the test; absent: none")] = None
    sampling: Annotated[SamplingTable | None, Meaning("sampling towards rare losses")] = None
    effects: Annotated[dict[str, EffectTable], Meaning("effects that virtual devices have, one table each")] = {}
    diagnosis: Annotated[DiagnosisTable, Meaning("examination of misfits after the last block")] = DiagnosisTable()
    lot_origin: Annotated[LotOriginTable, Meaning("whether a measured lot comes from the population for screening")] = (
        LotOriginTable()
    )
    rule: Annotated[RuleTable | RuleName, Meaning("rule by which a device is judged: a name or a table")] = RuleTable()
    limits: Annotated[
        dict[str, BoundsTable], Meaning("limits by quantity, one table each; absent: the shipped limits")
    ] = {}

    def judged_by(self, where: str = "run configuration") -> Limits:
        """Limits and rule; the shipped limits if the file has no [limits].

        Raises
        ------
        ConfigError : as :func:`reports.limits.load_limits`; ``where`` names the file in the message.
        """
        judged = checked_limits(self.rule, self.limits, where)
        return judged if self.limits else Limits(judged.rule, DEFAULT_LIMITS.limits)

    def judging_gate(self) -> Gate:
        """The gate of [gate] for the limits of the run."""
        return self.gate.gate(self.judged_by())

    def hum_source(self) -> Hum:
        """Hum that is added to virtual records: frequency [Hz] and amplitudes [V]."""
        return Hum(float(self.hum.frequency_hz), self.hum.amplitude_v)

    def line_hz(self) -> float | None:
        """Fundamental of the hum lines in the model [Hz], or ``None``."""
        return float(self.hum.frequency_hz) if self.hum.amplitude_v else None


def load_config(path: Path | None, overrides: Mapping[str, Any] | None = None) -> RunConfig:
    """The configuration in ``path`` (``None``: the shipped default), with the [run] keys in ``overrides`` replaced.

    Raises
    ------
    ConfigError : the file cannot be read, or a key or value in it cannot be used.
    """
    source = path or DEFAULT_CONFIG
    config = load(source, RunConfig, "run configuration", "run without it: gyroscreen run")
    config = changed_config(config, overrides or {})
    config = config if path is None else _with_absolute_paths(config, path.absolute().parent)
    _check(config, source.name)
    return config


def with_stated_limits(config: RunConfig) -> RunConfig:
    """``config`` with the shipped limits stated where it has no [limits]: a run stores those by which it was judged."""
    return config if config.limits else msgspec.structs.replace(config, limits=bounds_of(DEFAULT_LIMITS))


def changed_config(config: RunConfig, overrides: Mapping[str, Any]) -> RunConfig:
    """``config`` with the [run] keys in ``overrides`` replaced; ConfigError for a value that cannot be used."""
    changed = msgspec.to_builtins(config.run) | dict(overrides)
    return msgspec.structs.replace(config, run=converted(changed, RunTable, "[run]"))


def _with_absolute_paths(config: RunConfig, base: Path) -> RunConfig:
    """Paths in the file are relative to ``base``, its folder."""
    source = config.source
    if source.spec.endswith(".toml"):
        source = msgspec.structs.replace(source, spec=_absolute(base, source.spec))
    if source.path is not None:
        source = msgspec.structs.replace(source, path=_absolute(base, source.path))
    folders = tuple(_absolute(base, folder) for folder in config.effect_folders)
    origin = config.lot_origin
    if origin.population.endswith(".toml"):
        origin = msgspec.structs.replace(origin, population=_absolute(base, origin.population))
    return msgspec.structs.replace(config, source=source, effect_folders=folders, lot_origin=origin)


def _absolute(base: Path, path: str) -> str:
    return os.path.normpath(base / path)


def _check(config: RunConfig, where: str) -> None:
    """Checks that concern more than one key."""
    e, i, noise = config.experiment, config.identification, config.noise
    if not len(e.start_hz) == len(e.stop_hz) == len(e.amplitude_v) == 2:
        raise ConfigError(
            f"{where}: experiment.start_hz, stop_hz and amplitude_v must have a value for each of the two drives",
            value=[list(e.start_hz), list(e.stop_hz), list(e.amplitude_v)],
            allowed="two values each",
            next_step="for example amplitude_v = [2.0, 2.0]",
        )
    if not any(e.amplitude_v):
        raise ConfigError(
            f"{where}: experiment.amplitude_v drives nothing",
            value=list(e.amplitude_v),
            allowed="at least one amplitude above 0 V",
            next_step="raise an amplitude",
        )
    rate = config.instrument.sample_rate_hz
    samples, most = rate * max(e.duration_s, e.silence_s, e.period_s), RECORD_VALUES // _COLUMNS
    if samples > most:
        raise ConfigError(
            f"{where}: the record of a device is too long",
            value=f"{samples:.3g} samples",
            allowed=f"at most {most} samples in each of duration_s, silence_s and period_s at sample_rate_hz",
            next_step="shorten them, or lower instrument.sample_rate_hz",
        )
    nyquist = rate / 2.0
    if not i.low_hz < i.high_hz <= nyquist:
        raise ConfigError(
            f"{where}: identification.low_hz and high_hz do not bound a band",
            value=[i.low_hz, i.high_hz],
            allowed=f"low_hz < high_hz <= {nyquist:g} Hz, half the sample rate",
            next_step="correct low_hz and high_hz",
        )
    if noise.sigma_v is not None and noise.snr_db is not None:
        raise ConfigError(
            f"{where}: [noise] is given twice",
            value={"sigma_v": noise.sigma_v, "snr_db": noise.snr_db},
            allowed="sigma_v or snr_db",
            next_step="remove one of them",
        )
    if config.instrument.hold == "bandlimited":
        raise ConfigError(
            f"{where}: a screening run cannot simulate this hold",
            value="bandlimited",
            allowed="zoh, foh",
            next_step="correct instrument.hold",
        )
    if config.source.kind == "campaigns" and config.source.path is None:
        raise ConfigError(
            f'{where}: source.kind = "campaigns" needs source.path',
            allowed="a folder that contains campaign folders",
            next_step='write path = ".." in [source]',
        )
    config.judged_by(where)
    night_limits(config.trend.limits, where)
    check_phase(config.demodulation, config.systematic, where)
    if not config.systematic.built().exact and config.posterior.stored_draws < LEAST_STORED_DRAWS:
        raise ConfigError(
            f"{where}: posterior.stored_draws is too small for [systematic]",
            value=config.posterior.stored_draws,
            allowed=f"at least {LEAST_STORED_DRAWS}: each stored draw is one value of the common errors in the yield interval",
            next_step="raise posterior.stored_draws or leave it out",
        )
    _check_figures(config, where)
    for name in config.sampling.limits if config.sampling is not None else ():
        check_known(name, config.judged_by(where).quantities, f"{where}: [sampling] limits", "limit")
    if config.trim is not None:
        config.trim.electrodes()
        config.trim.target()


def _check_figures(config: RunConfig, where: str) -> None:
    """Raise ConfigError where a limited performance figure of a population would be null; campaigns may declare what it needs."""
    # A population states angular gain and temperature, and its silent records show the noise.
    known = msgspec.structs.replace(config.operation, temperature_c=0.0, pickoff_noise_v=1.0).built()
    point = OperatingPoint(known, angular_gain=1.0, bias_v=config.instrument.bias_v or None)
    for name in config.limits if config.source.kind == "population" else ():
        figure = find_figures().get(name)
        if figure is not None and figure.missing(point):
            raise ConfigError(
                f"{where}: [limits.{name}] limits a quantity that is unknown",
                value={key: None for key in figure.needs if not point.declared(key)},
                allowed="a figure whose inputs are declared",
                next_step=f"declare {by_table(figure.missing(point))} (docs/explanation/performance.md), or leave the limit out",
            )


def config_of_run(text: str, where: str) -> RunConfig:
    """The configuration that a run stored as its run.toml; ``where`` names the file in messages.

    Raises
    ------
    ConfigError : the file was edited and can no longer be used.
    """
    return decode(text.encode(), RunConfig, where)


def to_toml_table(config: RunConfig) -> dict[str, Any]:
    """The configuration as plain data, defaults filled in."""
    plain: dict[str, Any] = msgspec.to_builtins(config)
    return plain
