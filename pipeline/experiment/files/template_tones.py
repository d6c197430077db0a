"""A commented campaign.toml for sweeps and frequency responses, with what was guessed, why, and what the files cannot tell."""

from __future__ import annotations

from collections.abc import Sequence

from ...toml_files import encoded
from .inspect_tones import ToneColumn, ToneInspection

#: Largest share of the rows that is held out.
_HELD = 0.3
#: A model file for a device that is no gyro.
TONE_MODEL = """\
# "velocity" or "displacement": alike for a sweep, whose phase is free; more modes where the response has more peaks
plant = { kind = "modal", modes = 1, sense = "velocity" }
"""


def tone_template(name: str, paths: Sequence[str], found: ToneInspection) -> str:
    """The text of a campaign.toml; ``name`` of the device, ``paths`` relative to its folder."""
    swept = found.kind == "sweep"
    what = "stepped sweeps of a lock-in amplifier, rows in time order" if swept else "frequency responses"
    lines = [
        "# Written by `gyroscreen init`.  Each line says what was guessed and why; check it with `gyroscreen check`.",
        f'kind = "{found.kind}"                   # {what}: a guess',
        "[device]",
        f"id = {encoded(name)}",
        "",
        "# What the files cannot tell:",
        "[instrument]",
        '# antialias = { kind = "butterworth", order = 8, corner_hz = 4800.0 }      # filter before the detector; absent: none',
        "bias_v = 0.0                    # bias of the drive electrodes [V]",
        "",
        "[columns]                       # value = gain * column - offset, in SI units; a gain of -1 inverts a column",
        *(f"{column.key} = {_source(column)}      # {tone_reason(column)}" for column in found.columns),
    ]
    if swept and not any(column.key == "drive1_V" for column in found.columns):
        lines.append('# drive1_V = ".."                # NOT STATED: the level of the drive is taken as 1 V')
    return "\n".join([*lines, "", *_records(paths, found)])


def _source(column: ToneColumn) -> str:
    place = f"name = {encoded(column.name)}" if column.named else f"number = {column.number}"
    if column.unit is None:
        return encoded(column.name) if column.named else str(column.number)
    return f'{{ {place}, unit = "{column.unit}" }}'


def tone_reason(column: ToneColumn) -> str:
    """Why a column was taken for its use, its unit and its range."""
    unit = f"in {column.unit}" if column.unit is not None else "unit not stated, taken as SI"
    return f"{column.why}; {unit}; {column.low:.6g} to {column.high:.6g}"


def _records(paths: Sequence[str], found: ToneInspection) -> list[str]:
    lines: list[str] = []
    for path, passes, rows in zip(paths, found.passes, found.rows):
        cut = _cut(passes, rows) if found.kind == "sweep" else rows
        entry = f"[[record]]\nfile = {encoded(path)}\n"
        if cut == rows:
            lines.append(
                f'{entry}role = "fit"                    # no pass repeats an earlier one: nothing is held out\n'
            )
            continue
        held = len([first for first, _, _ in passes if first >= cut])
        lines += [
            f"# The last {held} passes repeat earlier ones: they are held out.",
            f'{entry}role = "fit"\nstop = {cut}\n',
            f'{entry}name = "last passes"\nrole = "validate"\nstart = {cut}\n',
        ]
    return lines


def _cut(passes: Sequence[tuple[int, str, float]], rows: int) -> int:
    """First row of the last passes that repeat earlier ones of their level and direction; ``rows`` where none does."""
    cut = rows
    for k in range(len(passes) - 1, 0, -1):
        first, direction, level = passes[k]
        repeated = any((d, v) == (direction, level) for _, d, v in passes[:k])
        if not repeated or rows - first > _HELD * rows:
            break
        cut = first
    return cut
