"""A commented campaign.toml for foreign files, with what was guessed, why, and what the files cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

from ...device.plant import SENSES, Sense
from ...toml_files import encoded
from ..instrument import Hold
from .inspect import FileColumn, Inspection
from .units import UNITS

#: Units of a quantity that follows displacement.
_DISPLACEMENTS = {"m", "strain", "rad"}
#: Share of a single record that is fitted; the rest is held out.
_FITTED = 0.5
_UNKNOWN = """\
# What the files cannot tell; correct it here before you trust a fit:
[instrument]
{rate}
hold = "{hold}"                # {why}how drive samples become volts: "zoh" steps, "foh" ramps, "bandlimited" (drive was recorded)
bias_v = {bias}                    # bias of the drive electrodes [V]
# antialias = {{ kind = "butterworth", order = 8, corner_hz = 4800.0 }}      # filter before the converter; absent: none
# adc = {{ bits = 16, full_scale_v = 10.0 }}                                # converter; absent: none
"""


def campaign_template(
    name: str,
    paths: Sequence[str],
    found: Inspection,
    gyro: bool,
    decay_s: float | None = None,
    hold: Hold = "zoh",
    why: str = "",
) -> str:
    """The text of a campaign.toml.

    Parameters
    ----------
    name : of the device.
    paths : of the files, relative to the folder of campaign.toml.
    found : what they seem to hold.
    gyro : whether the device has two drives and two senses, as the gyro of the paper.
    decay_s : where the free decay that the file shows begins [s]; ``None``: it shows none.
    hold, why : of the drive samples, and what shows it.
    """
    rate = (
        f"sample_rate_hz = {found.sample_rate_hz:.12g}        # {found.rate_from}"
        if found.sample_rate_hz is not None
        else "sample_rate_hz = 1.0            # NOT STATED in the files: frequencies are in cycles per sample until it is"
    )
    parts = [
        "# Written by `gyroscreen init`.  Each line says what was guessed and why; check it with `gyroscreen check`.",
        "[device]",
        f"id = {encoded(name)}",
        *(["# angular_gain = 0.7             # I_p / I_0p, needed for rate biases in deg/s"] if gyro else []),
        *(
            ["# [operation]: drive amplitude, gap, mass, .. for performance figures: docs/explanation/performance.md"]
            if gyro
            else []
        ),
        "",
        _UNKNOWN.format(rate=rate, bias="5.0" if gyro else "0.0", hold=hold, why=f"{why}; " if why else ""),
        *_columns(found),
        *(_records(paths, found) if decay_s is None else _decay(paths[0], decay_s)),
    ]
    return "\n".join(parts)


def stated_senses(found: Inspection) -> tuple[Sense, ...]:
    """What the senses may sense by their units: one thing, or all where no unit tells."""
    units = {UNITS[column.unit][0] for column in found.of("sense") if column.unit is not None}
    if units and units <= _DISPLACEMENTS:
        return ("displacement",)
    return ("acceleration",) if units == {"m/s^2"} else SENSES


def model_template(found: Inspection, sense: Sense | None = None, why: str = "a guess") -> str:
    """The text of a model file for a device that is no gyro: one mode, sensed as the units or ``sense`` tell."""
    stated = stated_senses(found)
    if len(stated) == 1:
        sense, why = stated[0], "the unit of the senses"
    return (
        f'plant = {{ kind = "modal", modes = 1, sense = "{sense or "velocity"}" }}\n'
        f"# sense is {', '.join(SENSES)}: {why}.  refine adds further modes.\n"
    )


def _columns(found: Inspection) -> list[str]:
    lines = ["[columns]                       # value = gain * column - offset, in SI units; add what nothing states"]
    for use in ("time", "drive", "sense"):
        for k, column in enumerate(found.of(use), 1):
            key = "time_s" if use == "time" else f"{use}{k}_V"
            if column.name != key:
                lines.append(f"{key} = {_source(column)}      # {reason(column)}")
            else:
                lines.append(f"# {key}: {reason(column)}")
    lines += [f"# not used: {encoded(c.name)} ({reason(c)})" for c in found.of("unused")]
    return [*lines, ""]


def _source(column: FileColumn) -> str:
    place = f"name = {encoded(column.name)}" if column.named else f"number = {column.number}"
    if column.unit is None:
        return encoded(column.name) if column.named else str(column.number)
    return f'{{ {place}, unit = "{column.unit}" }}'


def reason(column: FileColumn) -> str:
    """Why a column was taken for its use, its unit and its range."""
    si = "" if column.unit is None or UNITS[column.unit][0] == column.unit else f", read in {UNITS[column.unit][0]}"
    if column.use == "unused":
        return column.why if isnan(column.low) else f"{column.why}; {column.low:.4g} to {column.high:.4g}"
    unit = f"in {column.unit}{si}" if column.unit is not None else "unit not stated, taken as V"
    return f"{column.why}; {unit}; {column.low:.4g} to {column.high:.4g}"


def _decay(path: str, start_s: float) -> list[str]:
    """The record of a free decay."""
    return [
        "# The motion falls to little, and no named drive stops then: a free decay.  Some of its pieces are held out; silence",
        "# behind it measures the noise.  No force is known: gains and sizes of effects are in units of the sense signal.",
        f'[[record]]\nfile = {encoded(path)}\nkind = "decay"',
        f"start_s = {start_s:.6g}                  # here the motion begins to fall\n" if start_s else "",
    ]


def _records(paths: Sequence[str], found: Inspection) -> list[str]:
    lines: list[str] = []
    divided = len(paths) == 1 and not found.silent[0] and found.samples[0] >= 256 and not found.gaps[0]
    driven = [k for k, silent in enumerate(found.silent) if not silent]
    held_out = driven[-1] if len(driven) > 1 else None
    for k, path in enumerate(paths):
        rest = "" if found.at_rest[k] else "at_rest = false                 # the senses move at the first sample\n"
        gaps = f"# {found.gaps[k]} gaps: each piece becomes a record of its own\n" if found.gaps[k] else ""
        if divided:
            cut = int(_FITTED * found.samples[0])
            entry = f"[[record]]\nfile = {encoded(path)}\nname = "
            lines += [
                "# One file: its first half is fitted, the second is held out.",
                f'{entry}"first half"\nrole = "fit"\nstop = {cut}\n{rest}',
                f'{entry}"second half"\nrole = "validate"\nstart = {cut}\nat_rest = false\n',
            ]
            continue
        role = "noise" if found.silent[k] else "validate" if k == held_out else "fit"
        why = {"noise": "no drive varies", "fit": "fitted", "validate": "held out; the fit never sees it"}[role]
        head = f'{gaps}[[record]]\nfile = {encoded(path)}\nrole = "{role}"'
        lines.append(f"{head}                   # {why}\n{rest}")
    return lines
