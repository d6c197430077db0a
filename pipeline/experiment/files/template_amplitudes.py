"""A commented campaign.toml for amplitudes of free decays, with what was guessed, why, and what the files cannot tell."""

from __future__ import annotations

from collections.abc import Sequence

from ...toml_files import encoded
from .inspect_amplitudes import AmplitudeColumn, AmplitudeInspection

#: A model file for amplitudes, which show one mode each.
AMPLITUDE_MODEL = """\
# One mode for each frequency that the records are tuned to.
plant = { kind = "modal", modes = 1, sense = "velocity" }
"""


def amplitude_template(name: str, paths: Sequence[str], found: AmplitudeInspection) -> str:
    """The text of a campaign.toml; ``name`` of the device, ``paths`` relative to its folder."""
    lines = [
        "# Written by `gyroscreen init`.  Each line says what was guessed and why; check it with `gyroscreen check`.",
        'kind = "decay_amplitude"       # amplitudes of free decays against time: a guess',
        "[device]",
        f"id = {encoded(name)}",
        "",
        "[columns]",
        *(f"{column.key} = {_source(column)}      # {amplitude_reason(column)}" for column in found.columns),
    ]
    return "\n".join([*lines, "", *(_record(path, found) for path in paths)])


def _source(column: AmplitudeColumn) -> str:
    if column.unit is None or column.key.endswith(("dBm", "dBV")):
        return encoded(column.name)
    return f'{{ name = {encoded(column.name)}, unit = "{column.unit}" }}'


def amplitude_reason(column: AmplitudeColumn) -> str:
    """Why a column was taken for its use, and its unit."""
    if column.key.endswith(("dBm", "dBV")):
        return column.why
    return f"{column.why}; {f'in {column.unit}' if column.unit else 'unit not stated, taken as SI'}"


def _record(path: str, found: AmplitudeInspection) -> str:
    volts = any(column.key.endswith(("_R_V", "_X_V")) for column in found.columns)
    power = any(column.key.endswith(("_W", "_dBm")) for column in found.columns)
    lines = [f"[[record]]\nfile = {encoded(path)}"]
    if not found.states_frequency:
        lines.append(
            "# frequency_hz = ..            # NOT STATED: reference of the lock-in, or centre of the analyzer [Hz]"
        )
    if volts:
        lines.append('amplitude = "peak"             # or "rms": the file does not tell')
    if power:
        lines.append("reference_ohm = 50.0           # impedance of the power: a guess")
    lines += [
        "# time_constant_s = ..         # of the lock-in; absent: fast",
        "# resolution_bandwidth_hz = .. # of the analyzer, instead",
    ]
    return "\n".join([*lines, ""])
