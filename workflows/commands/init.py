"""gyroscreen init: look at foreign files, write a commented campaign.toml, plot what was read."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import GyroscreenError, UsageError, printable_lines, unwritable
from pipeline.experiment.campaign import read_campaign, read_measurement
from pipeline.experiment.files.inspect import Inspection, inspect
from pipeline.experiment.files.inspect_amplitudes import AmplitudeInspection, inspect_amplitudes
from pipeline.experiment.files.inspect_tones import ToneInspection, inspect_tones
from pipeline.experiment.files.readers import existing, read_columns
from pipeline.experiment.files.ring_down import ring_down
from pipeline.experiment.files.template import campaign_template, model_template, reason, stated_senses
from pipeline.experiment.files.template_amplitudes import AMPLITUDE_MODEL, amplitude_reason, amplitude_template
from pipeline.experiment.files.template_tones import TONE_MODEL, tone_reason, tone_template
from pipeline.experiment.tones import ToneCampaign

FILE, MODEL, PICTURE = "campaign.toml", "model.toml", "columns.png"
_OTHER = "choose another folder with --out"


def init(files: Sequence[Path], out: Path | None) -> None:
    """See ``gyroscreen init --help``."""
    folder = out or Path(f"{existing(files[0]).stem}-campaign")
    target = folder / FILE
    if target.exists():
        raise UsageError(
            "the campaign exists already",
            value=str(target),
            next_step="choose another folder with --out, or move the old campaign.toml away",
        )
    paths = [Path(os.path.relpath(file, folder)).as_posix() for file in files]
    columns = [(file.name, read_columns(file)) for file in files]
    if (amplitudes := inspect_amplitudes(columns)) is not None:
        _init_amplitudes(folder, files, paths, amplitudes)
        return
    if (tones := inspect_tones(columns)) is not None:
        _init_tones(folder, files, paths, tones)
        return
    from .first_model import first_model

    found = inspect(columns)
    decay = ring_down(columns[0][1], found) if len(files) == 1 else None
    found = found if decay is None else decay.found
    signals = (*found.of("drive"), *found.of("sense"))
    # Two inputs and two outputs without names are more often those of another device.
    gyro = len(found.of("drive")) == len(found.of("sense")) == 2 and all(column.named for column in signals)
    _write(
        folder,
        target,
        campaign_template(folder.resolve().name, paths, found, gyro, None if decay is None else decay.start_s),
    )
    if not gyro:
        _write(folder, folder / MODEL, model_template(found))
    print(printable_lines("\n".join(_text(files, found))))
    if decay is not None:
        print(f"  a free decay from {decay.start_s:.6g} s on")
    try:
        campaign = read_campaign(folder)
        tried = None if gyro or decay is not None else first_model(campaign, stated_senses(found))
        if tried is not None:
            why = "" if tried.hold == "zoh" else "one mode fits better with it"
            text = campaign_template(folder.resolve().name, paths, found, gyro, None, tried.hold, why)
            _write(folder, target, text)
            _write(folder, folder / MODEL, model_template(found, tried.sense, tried.reason))
            print(f'  sense = "{tried.sense}", hold = "{tried.hold}": {tried.reason}')
    except GyroscreenError as error:
        print(f"{target} is written, but the records cannot be read with it yet: {error}")
        return
    from reports.learning.figures.columns import columns_png

    try:
        columns_png(campaign.records, folder / PICTURE)
    except OSError as error:
        raise unwritable("the picture", folder / PICTURE, error, _OTHER) from None
    _print_next_steps(folder, "" if gyro else f" --model {folder / MODEL}")


def _init_tones(folder: Path, files: Sequence[Path], paths: Sequence[str], found: ToneInspection) -> None:
    """The campaign of sweeps and frequency responses."""
    gyro = found.kind == "frf" and any(column.key.startswith("H_s2d2") for column in found.columns)
    _write(folder, folder / FILE, tone_template(folder.resolve().name, paths, found))
    if not gyro:
        _write(folder, folder / MODEL, TONE_MODEL)
    lines = [f"{len(files)} files, kind {found.kind}"]
    for file, rows, passes in zip(files, found.rows, found.passes):
        lines.append(f"  {file.name}: {rows} rows, {len(passes)} passes")
    lines += [f"  column {one.number} {one.name!r}: {one.key} ({tone_reason(one)})" for one in found.columns]
    print(printable_lines("\n".join(lines)))
    _read_again(folder, "" if gyro else f" --model {folder / MODEL}")


def _init_amplitudes(folder: Path, files: Sequence[Path], paths: Sequence[str], found: AmplitudeInspection) -> None:
    """The campaign of amplitudes of free decays."""
    _write(folder, folder / FILE, amplitude_template(folder.resolve().name, paths, found))
    _write(folder, folder / MODEL, AMPLITUDE_MODEL)
    lines = [f"{len(files)} files, kind decay_amplitude"]
    lines += [f"  {file.name}: {rows} rows" for file, rows in zip(files, found.rows)]
    lines += [f"  column {one.number} {one.name!r}: {one.key} ({amplitude_reason(one)})" for one in found.columns]
    print(printable_lines("\n".join(lines)))
    _read_again(folder, f" --model {folder / MODEL}")


def _read_again(folder: Path, model: str) -> None:
    """Read the campaign as it was written, plot what was read, and say what comes next."""
    try:
        campaign = read_measurement(folder)
    except GyroscreenError as error:
        print(printable_lines(f"{folder / FILE} is written, but the records cannot be read with it yet: {error}"))
        return
    from reports.learning.figures.amplitudes import amplitudes_png
    from reports.learning.figures.tones import tones_png

    if isinstance(campaign, ToneCampaign):
        try:
            if campaign.records:
                tones_png(campaign.records, folder / PICTURE)
            else:
                amplitudes_png(campaign.envelopes, folder / PICTURE)
        except OSError as error:
            raise unwritable("the picture", folder / PICTURE, error, _OTHER) from None
    _print_next_steps(folder, model)


def _print_next_steps(folder: Path, model: str) -> None:
    written = f"{folder / FILE}: correct its lines where they are wrong; {folder / PICTURE} shows what was read"
    print(printable_lines(f"{written}\nnext: gyroscreen check {folder}, then gyroscreen refine {folder}{model}"))


def _write(folder: Path, target: Path, text: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(target.name, target, error, _OTHER) from None


def _text(files: Sequence[Path], found: Inspection) -> list[str]:
    rate = "not stated" if found.sample_rate_hz is None else f"{found.sample_rate_hz:.9g} Hz"
    lines = [f"{len(files)} files, sample rate {rate}"]
    for file, samples, gaps, silent in zip(files, found.samples, found.gaps, found.silent):
        notes = [f"{gaps} gaps"] * bool(gaps) + ["no drive varies"] * silent
        lines.append(f"  {file.name}: {samples} samples{', ' if notes else ''}{', '.join(notes)}")
    for column in found.columns:
        use = "not used" if column.use == "unused" else column.use
        lines.append(f"  column {column.number} {column.name!r}: {use} ({reason(column)})")
    return lines
