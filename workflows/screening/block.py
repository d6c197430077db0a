"""One block of devices: drawn or read, chirped, identified, judged; two tables out.

A block is a pure function of the configuration and of which devices it holds, so workers, block sizes and resumption
cannot change a result.  Random streams: SeedSequence(seed, spawn_key=(stream, n)) for device n.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from zlib import crc32

import msgspec
import numpy as np
import pyarrow as pa
from threadpoolctl import threadpool_limits

import populations
from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL, gyro_modes
from pipeline.device.model import Model
from pipeline.device.operation.bias import quantities_of
from pipeline.errors import ConfigError, GyroscreenError
from pipeline.experiment.antialias import behind_filter
from pipeline.experiment.excitation import drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.forward.record import forward
from pipeline.experiment.noise.lines import silent_sigma
from pipeline.experiment.noise.measure import measured
from pipeline.experiment.record import Record
from pipeline.identification.bandpass import window_slice
from pipeline.inference.screening.device import (
    DeviceResult,
    FitRecord,
    IdentificationSettings,
    RateSettings,
    identify_device,
    prepare,
)
from pipeline.quantities import MODEL, NAMES
from pipeline.store.schema import devices_table, posterior_table
from populations.draw import Draw, draw
from populations.spec import PopulationSpec, load_spec
from reports.decision import conforms, decide
from reports.limits import Limits

from ..config import RunConfig
from .trimming import trimmed_columns

_NOISE_STREAM, _POSTERIOR_STREAM, _TRIM_STREAM, _EFFECT_STREAM = 101, 102, 107, 108


@dataclass(frozen=True)
class DeviceBlock:
    """Block ``index`` holds the devices first .. first + count - 1 of the run."""

    index: int
    first: int
    count: int


@dataclass(frozen=True, eq=False)
class BlockTables:
    """What a block leaves: devices, posterior draws (``None`` where none are stored), and counts by status."""

    index: int
    devices: pa.Table
    posterior: pa.Table | None
    statuses: dict[str, int]


def blocks_of(config: RunConfig, devices: int) -> tuple[DeviceBlock, ...]:
    """The run cut into blocks."""
    size = config.run.block
    return tuple(DeviceBlock(i, i * size, min(size, devices - i * size)) for i in range(-(-devices // size)))


@lru_cache(maxsize=4)
def population_of(config_spec: str, values: tuple[tuple[str, float], ...]) -> PopulationSpec:
    """The population that [source] names, with its named assumptions set."""
    path = Path(config_spec)
    shipped = path.suffix != ".toml"
    spec = load_spec(_shipped_spec(config_spec) if shipped else path)
    return spec.with_values(dict(values)) if values else spec


def _shipped_spec(name: str) -> Path | None:
    return None if name == "cloverleaf" else Path(populations.__file__).parent / "specs" / f"{name}.toml"


def population(config: RunConfig) -> PopulationSpec:
    """The population of a configuration."""
    return population_of(config.source.spec, tuple(sorted(config.source.values.items())))


def settings_of(config: RunConfig) -> IdentificationSettings:
    """Identification settings of a configuration."""
    i = config.identification
    return IdentificationSettings(i.order, i.window_s, i.low_hz, i.high_hz, config.line_hz())


def rate_of(config: RunConfig, angular_gain: float | None) -> RateSettings:
    """Rate settings of a configuration."""
    return RateSettings(angular_gain, config.demodulation.phase_error_deg, config.demodulation.drive)


def _seed(config: RunConfig, stream: int, n: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(config.run.seed, spawn_key=(stream, n))


def physical_of(values: Mapping[str, FloatArray]) -> FloatArray:
    """Physical parameters (B, 12) of arrays by quantity name."""
    return np.stack([values[name] for name in PHYSICAL], axis=-1)


@lru_cache(maxsize=2)
def _shared(config_key: bytes) -> FitRecord:
    config = msgspec.msgpack.decode(config_key, type=RunConfig)
    instrument = config.instrument.instrument()
    drive = drive_samples(config.experiment.excitation(), instrument.sample_rate_hz)
    record = Record("chirp", instrument.sample_rate_hz, drive, np.zeros_like(drive), role="fit")
    return prepare(record, instrument, settings_of(config))


def shared_record(config: RunConfig) -> FitRecord:
    """Drive, band and nuisance basis that every virtual device of a run shares."""
    return _shared(msgspec.msgpack.encode(config))


def virtual_volts(config: RunConfig, drawn: Draw, i: int) -> FloatArray:
    """Pick-off volts (N, 2) of device i of a draw, before hum, noise and converter; with the effects that the run names."""
    instrument = config.instrument.instrument()
    shared = shared_record(config).record
    physical = physical_of(drawn.true)[i : i + 1]
    if not config.experiment.effects and not config.effects:
        bank = behind_filter(gyro_modes(physical), instrument.antialias)
        return respond(bank, shared.drive_v, instrument.sample_rate_hz, instrument.hold)[0]
    model = physics_of(config)
    values = dict(zip(PHYSICAL, physical[0].tolist()))
    for name, parameters in drawn.effects.items():
        if name in config.experiment.effects:
            values |= {f"{name}.{parameter}": float(value[i]) for parameter, value in parameters.items()}
    values |= carried_sizes(config, model, int(drawn.index[i]), drawn.device_id[i], drawn.lot[i])
    return forward(model, values, shared, instrument)


def carried_sizes(config: RunConfig, model: Model, n: int, device_id: str, lot: str) -> dict[str, float]:
    """Sizes by parameter of what [effects] gives device n; nothing where it carries none."""
    out: dict[str, float] = {}
    for name, table in sorted(config.effects.items()):
        random = np.random.default_rng(
            np.random.SeedSequence(config.run.seed, spawn_key=(_EFFECT_STREAM, n, crc32(name.encode())))
        )
        carries = random.random() < table.share if not table.devices else device_id in table.devices
        if not carries or (table.lots and lot not in table.lots):
            continue
        for parameter, (mean, sd) in sorted(table.size.items()):
            full = f"{name}.{parameter}"
            out[full] = float(np.clip(mean + sd * random.standard_normal(), *model.bounds(full)))
    return out


def physics_of(config: RunConfig) -> Model:
    """The model that virtual devices obey: the plant with c12, and the effects of [experiment] and [effects].

    Raises
    ------
    ConfigError : an effect that does not exist, or that no population draws; a size of no parameter of its.
    """
    named = config.experiment.effects
    model = Model(effects=tuple(dict.fromkeys(("offdiagonal_damping", *named, *config.effects))))
    for name, table in config.effects.items():
        effect = model.effect(name)
        own = [member.name for member in effect.members(model.built.shape)]
        if name in named or name == "offdiagonal_damping" or effect.disturbance is not None:
            raise ConfigError(
                "[effects] cannot give this effect", value=name, allowed="effects that [experiment] does not"
            )
        for parameter in table.size:
            if parameter not in own:
                raise ConfigError(f"no such parameter of {name}", value=parameter, allowed=", ".join(own))
    drawn = draw(population(config), config.run.seed, 0, 1).effects
    for name in named:
        if name not in drawn:
            raise ConfigError("no irregularity gives this effect a size", value=name, allowed=", ".join(sorted(drawn)))
    return model


def virtual_records(config: RunConfig, drawn: Draw, i: int) -> tuple[FloatArray, FloatArray, float]:
    """Silent and fit record (N, 2) [V] of device i of a draw, and the sigma of its noise [V]."""
    instrument = config.instrument.instrument()
    volts = virtual_volts(config, drawn, i)
    sigma = config.noise.sigma_v or 0.001
    if config.noise.snr_db is not None:
        window = window_slice(volts, instrument.sample_rate_hz, config.identification.window_s)
        sigma = float(np.sqrt(np.mean(volts[window] ** 2)) * 10.0 ** (-config.noise.snr_db / 20.0))
    random = np.random.default_rng(_seed(config, _NOISE_STREAM, int(drawn.index[i])))
    hum, rate = config.hum_source(), instrument.sample_rate_hz
    quiet = np.zeros((round(config.experiment.silence_s * rate), 2))
    silent = measured(quiet, rate, sigma, hum, instrument.adc, random)
    return silent, measured(volts, rate, sigma, hum, instrument.adc, random), sigma


def identify_virtual(config: RunConfig, drawn: Draw, i: int, angular_gain: float) -> DeviceResult:
    """Chirp and identify device i of a draw."""
    instrument = config.instrument.instrument()
    shared = shared_record(config)
    silent, fit, _ = virtual_records(config, drawn, i)
    sigma = silent_sigma(silent, instrument.sample_rate_hz, config.line_hz(), instrument.adc)
    record = Record("chirp", instrument.sample_rate_hz, shared.record.drive_v, fit, role="fit")
    return identify_device(
        [FitRecord(record, shared.band, shared.nuisance)],
        sigma,
        instrument,
        settings_of(config),
        config.posterior.settings(),
        config.gate.gate(),
        rate_of(config, angular_gain),
        _seed(config, _POSTERIOR_STREAM, int(drawn.index[i])),
    )


def _guarded(config: RunConfig, drawn: Draw, i: int, angular_gain: float) -> DeviceResult:
    # One odd device must not take the night down; its row says what happened.
    try:
        return identify_virtual(config, drawn, i, angular_gain)
    except (GyroscreenError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        reason = f"{type(error).__name__}: {error}"
        columns: dict[str, float | str | None] = {"status": "fit_failed", "status_reason": reason}
        return DeviceResult(columns, {}, "fit_failed", reason, None)


def truth_columns(config: RunConfig, drawn: Draw, angular_gain: float) -> dict[str, FloatArray]:
    """fab_<q> and true_<q> of a draw."""
    out: dict[str, FloatArray] = {}
    for prefix, values in (("fab", drawn.fab), ("true", drawn.true)):
        rate = rate_of(config, angular_gain)
        all_q = quantities_of(physical_of(values), angular_gain, rate.phase_error_deg, rate.drive)
        all_q["split_hz"] = values["split_hz"]
        out |= {f"{prefix}_{name}": all_q[name] for name in NAMES}
    return out


def _causes(limits: Limits, truth: Mapping[str, FloatArray]) -> list[str | None]:
    """Which stage made the truth fail the limits; ``None`` where it does not."""
    fab = conforms(limits, {q: truth[f"fab_{q}"] for q in limits.quantities})
    true = conforms(limits, {q: truth[f"true_{q}"] for q in limits.quantities})
    return [None if t else ("packaging" if f else "fabrication") for f, t in zip(fab, true)]


def judged(results: Sequence[DeviceResult], limits: Limits) -> dict[str, list[Any]]:
    """p_pass, verdict and failed_limits of each result."""
    out: dict[str, list[Any]] = {"p_pass": [], "verdict": [], "failed_limits": []}
    for result in results:
        draws = {q: result.draws.get(q, np.full(1, np.nan))[None] for q in limits.quantities}
        decision = decide(limits, draws, [result.status])
        out["p_pass"].append(float(decision.p_pass[0]))
        out["verdict"].append(decision.verdict[0])
        out["failed_limits"].append(decision.failed_limits[0])
    return out


def tables_of(
    index: int,
    device_id: Sequence[str],
    fixed: Mapping[str, Any],
    results: Sequence[DeviceResult],
    limits: Limits,
    stored_draws: int,
) -> BlockTables:
    """The tables of a block: ``fixed`` columns, estimates, decisions, thinned draws."""
    names = sorted({name for result in results for name in result.columns})
    columns: dict[str, Any] = {name: [result.columns.get(name) for result in results] for name in names}
    devices = devices_table({"device_id": list(device_id), **fixed, **columns, **judged(results, limits)})
    statuses: dict[str, int] = {}
    for result in results:
        statuses[result.status] = statuses.get(result.status, 0) + 1
    posterior = None
    if stored_draws:
        parts: dict[str, list[Any]] = {"device_id": [], "draw": [], **{q.name: [] for q in MODEL}}
        for identity, result in zip(device_id, results):
            if not result.draws:
                continue
            total = result.draws["theta_deg"].size
            kept = np.linspace(0, total - 1, min(stored_draws, total)).round().astype(np.int64)
            parts["device_id"] += [identity] * kept.size
            parts["draw"].append(np.arange(kept.size, dtype=np.int32))
            for q in MODEL:
                parts[q.name].append(result.draws[q.name][kept])
        joined = {k: (v if k == "device_id" else np.concatenate(v) if v else []) for k, v in parts.items()}
        posterior = posterior_table(joined)
    return BlockTables(index, devices, posterior, statuses)


def _with_trim(
    config: RunConfig, limits: Limits, results: Sequence[DeviceResult], drawn: Draw, gain: float
) -> list[DeviceResult]:
    """The results with their trim columns, where the run has a [trim]."""
    if config.trim is None:
        return list(results)
    physical, rate = physical_of(drawn.true), rate_of(config, gain)
    out = []
    for i, result in enumerate(results):
        seed = _seed(config, _TRIM_STREAM, int(drawn.index[i]))
        more = trimmed_columns(config.trim, limits, result, physical[i], rate, seed)
        out.append(replace(result, columns={**result.columns, **more}))
    return out


def virtual_block(config: RunConfig, block: DeviceBlock) -> BlockTables:
    """Draw, chirp, identify and judge the virtual devices of ``block``."""
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = draw(spec, config.run.seed, block.first, block.count)
        gain = float(spec.angular_gain)
        results = [_guarded(config, drawn, i, gain) for i in range(block.count)]
        truth = truth_columns(config, drawn, gain)
        limits = config.judged_by()
        results = _with_trim(config, limits, results, drawn, gain)
        fixed = {
            "lot": list(drawn.lot),
            "wafer": list(drawn.wafer),
            "die_x_mm": drawn.die_x_mm,
            "die_y_mm": drawn.die_y_mm,
            "package": list(drawn.package),
            "cause": _causes(limits, truth),
            **truth,
        }
        return tables_of(block.index, drawn.device_id, fixed, results, limits, config.posterior.stored_draws)


def declared_id(folder: Path) -> str:
    """The device id of a campaign folder; the folder's name where its campaign.toml cannot be read (its row says why)."""
    try:
        return str(tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))["device"]["id"])
    except (OSError, ValueError, KeyError, TypeError):
        return folder.name


def campaign_folders(path: Path) -> tuple[Path, ...]:
    """Folders below ``path`` that hold a campaign.toml, in order of their names."""
    return tuple(sorted(file.parent for file in path.glob("*/campaign.toml")))
