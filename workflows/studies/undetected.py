"""Study of effects that a nightly run does not detect: is a device that is "ok" within its interval and the bound of its bias?

Each effect of the library that the nightly fit lacks is hidden in devices of the population, with a size that is log-uniform from
invisible to loud, by the simulator that shares no code with the model under test (``hidden.truth``).  Of each device:

    status, the p-value, and for every quantity whether [q05, q95] and [q05 - bound, q95 + bound] contain the truth

    DIR/<effect>.jsonl    one JSON object per device; an interrupted study continues there

A row depends on (seed, effect, number) only.  The effect "none" is no effect: its share of misfits is that of false alarms.
Shapes: N samples of a record, (N, 2) [V].
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.errors import GyroscreenError, UsageError
from pipeline.experiment.noise.measure import measured
from pipeline.experiment.noise.spectrum import noise_spectrum
from pipeline.experiment.record import Record
from pipeline.inference.estimate import quantities
from pipeline.inference.screening.device import FitRecord, identify_device
from pipeline.inference.screening.mismatch import NIGHTLY_MODEL
from pipeline.inference.screening.undetected.library import scored_effects
from populations.draw import Draw, draw

from ..config import RunConfig, load_config
from ..process import worker_count
from ..screening.settings import POSTERIOR_STREAM, device_seed, population, rate_of, settings_of
from ..screening.virtual_device import physical_of, shared_record, virtual_volts
from .coverage import COVERED, Share, offsets
from .hidden.effects import draw_effect, peak_of
from .hidden.own_law import modelled_response, without_law
from .hidden.study import make_folder, resumed, rows_in
from .hidden.truth import clipped, hum, response

NONE = "none"
#: Sizes: from a thousandth to ten times that of an SNR of about 100.
_SIZES = 1e-3, 10.0
#: A clip level below the peak by 1e-5 to 1: the samples at the peak are few.
_CLIPS = 1e-5, 1.0
_STREAM = 110


def effects_of(name: str) -> tuple[str, ...]:
    """The effects to hide: one, or all that the nightly fit lacks, and none.

    Raises
    ------
    UsageError : no such effect.
    """
    library = (*(effect.name for effect in scored_effects(True)), NONE)
    if name == "all":
        return library
    if name not in library:
        raise UsageError("no such effect that the nightly fit lacks", value=name, allowed=f"all, {', '.join(library)}")
    return (name,)


def _drawn_sizes(
    effect: str, values: Mapping[str, float], clean_v: FloatArray, drive_v: FloatArray, random: np.random.Generator
) -> dict[str, float]:
    """Sizes of an effect in a device of parameters ``values`` whose record without it is ``clean_v`` (N, 2) [V]."""
    if effect == NONE:
        return {}
    drawn = draw_effect(effect, values, peak_of([clean_v], [drive_v]), random, NIGHTLY_MODEL)
    clips = NIGHTLY_MODEL.effect(effect).stages == ("adc",)
    low, high = _CLIPS if clips else _SIZES
    size = float(low * (high / low) ** random.uniform()) + (1.0 if clips else 0.0)
    return {**drawn.at(min(size, drawn.most)), "adc_saturation.clips_noise": 0.0}


def examine(config: RunConfig, drawn: Draw, i: int, effect: str) -> dict[str, Any]:
    """The row of device ``i`` of a draw with ``effect`` hidden in it."""
    spec, instrument, shared = population(config), config.instrument.instrument(), shared_record(config)
    number = int(drawn.index[i])
    key = (_STREAM, crc32(effect.encode()), number)
    random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=key))
    physical = physical_of(drawn.true)[i]
    plant = dict(zip(PHYSICAL, physical.tolist()))
    for name in config.experiment.effects:
        plant |= {f"{name}.{parameter}": float(value[i]) for parameter, value in drawn.effects[name].items()}
    drive, rate = shared.record.drive_v, instrument.sample_rate_hz
    values = plant | _drawn_sizes(effect, plant, virtual_volts(config, drawn, i), drive, random)
    if effect != NONE and without_law((effect,)):
        clean = modelled_response(NIGHTLY_MODEL, (effect,), values, shared.record, instrument)
    else:
        clean = clipped(response(values, drive, instrument), values)
    silent = np.zeros((round(config.experiment.silence_s * rate), 2))
    silent_v, fit_v = (
        measured(
            y + hum(values, y.shape[0], rate, random),
            rate,
            config.noise.sigma_v or 0.001,
            config.hum_source(),
            instrument.adc,
            random,
            config.noise.noise_kind(),
        )
        for y in (silent, clean)
    )
    angular_gain = float(spec.angular_gain)
    result = identify_device(
        [FitRecord(Record("chirp", rate, drive, fit_v, role="fit"), shared.band, shared.nuisance)],
        noise_spectrum(silent_v, rate, config.line_hz(), instrument.adc),
        instrument,
        settings_of(config),
        config.posterior.settings(),
        config.judging_gate(),
        rate_of(config, angular_gain),
        device_seed(config, POSTERIOR_STREAM, number),
    )
    c: dict[str, Any] = result.columns
    row: dict[str, Any] = {
        "kind": effect,
        "number": number,
        "seed": config.run.seed,
        "sizes": {name: value for name, value in values.items() if name not in plant},
        "status": result.estimate.status,
        "closest": c.get("closest_effect"),
        "p_value": c.get("effect_p_value"),
        "failed": "",
    }
    if result.fit is not None:
        truth = quantities(physical, rate_of(config, angular_gain), drawn.true["split_hz"][i])
        row |= {name: _judged(c, name, float(truth[name])) for name in COVERED}
    return row


def _judged(c: Mapping[str, Any], name: str, truth: float) -> dict[str, float | bool]:
    """Error and bound [sd], and whether the interval holds the truth, as it is and widened by the bound."""
    bound, sd = c[f"{name}_bias_bound"], c[f"{name}_sd"]
    error, low, high = offsets(c, name, truth)
    return {
        "z": error / sd,
        "bound": bound / sd,
        "inside": low <= 0.0 <= high,
        "widened": low - bound <= 0.0 <= high + bound,
    }


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of ``item`` = (effect, number), computed on a worker; a device that cannot be simulated states why."""
    effect, number = item
    with threadpool_limits(limits=1):
        config = load_config(None, {"seed": seed})
        try:
            return examine(config, draw(population(config), seed, number, 1), 0, effect)
        except (GyroscreenError, ArithmeticError, ValueError) as error:
            reason = f"{type(error).__name__}: {error}"
            return {"kind": effect, "number": number, "seed": seed, "status": "", "failed": reason}


def run_study(effects: Sequence[str], devices: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Run the devices that are missing in ``folder``; yields (devices done, devices planned) each time one finishes.

    Raises
    ------
    UsageError : no devices, or a folder that cannot be written.
    ConfigError : an invalid seed.
    """
    if devices < 1:
        raise UsageError("no devices to study", value=devices, allowed="1 or more")
    load_config(None, {"seed": seed})
    worker_count(workers)
    make_folder(folder)
    wanted = [(effect, number) for number in range(devices) for effect in effects]
    before = {(row["kind"], row["number"]) for row in rows_in(folder, effects, seed)}
    yield from resumed(study_row, seed, wanted, before, folder, workers)


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The figures of the study by name; shares as :class:`Share`, of the devices that are ok."""
    ok = [row for row in rows if row["status"] == "ok" and row["kind"] != NONE]
    clean = [row for row in rows if row["kind"] == NONE]
    found: dict[str, Any] = {
        "devices with an effect; ok": Share(len(ok), sum(row["kind"] != NONE for row in rows)),
        "without an effect: ok": Share(sum(row["status"] == "ok" for row in clean), len(clean)),
        "failed": sum(bool(row["failed"]) for row in rows),
    }
    for name, label in COVERED.items():
        share = partial(_share, ok, name)
        found[f"{label} inside its interval"] = share("inside")
        found[f"{label} inside its interval, widened by the bound"] = share("widened")
    for name, label in COVERED.items():
        own = [row[name]["bound"] for row in clean if name in row]
        found[f"median of bound / sd of {label}, no effect"] = float(np.median(own)) if own else float("nan")
    return found


def _share(rows: Sequence[Mapping[str, Any]], name: str, what: str) -> Share:
    return Share(sum(row[name][what] for row in rows), len(rows))


def by_effect(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """For each effect: devices, those ok, significant ones, and the widened coverage of every quantity among the ok ones."""
    out: dict[str, dict[str, Any]] = {}
    for effect in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == effect]
        ok = [row for row in own if row["status"] == "ok"]
        out[effect] = {"devices": len(own), "ok": len(ok)}
        out[effect] |= {label: _share(ok, name, "widened") for name, label in COVERED.items()}
        out[effect]["largest error, sd"] = max((abs(row[name]["z"]) for row in ok for name in COVERED), default=0.0)
    return out
