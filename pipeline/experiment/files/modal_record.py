"""Modal records: poles and residues that were identified elsewhere (paper, eq. 14).

    H(s) = sum_m (s R1_m + R0_m) / (s^2 + 2 zeta_m w_m s + w_m^2),   w_m = 2 pi f_m

H is volts per volt, from the drives to the senses after the anti-alias filter.

Shapes: M modes, S senses (rows), D drives (columns).  Units: R1 [1/s], R0 [1/s^2]; ``sd`` holds the standard deviations of R1
and of R0 / w, both in 1/s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from ... import toml_files as toml
from ...arrays import FloatArray
from ...errors import ConfigError, MeasurementError, unwritable
from ...toml_keys import Meaning
from ..instrument import AntiAlias
from .common_tables import AntiAliasTable, DemodulationTable, DeviceTable, Positive, References, references
from .readers import existing

# A matrix that is not finite is a fault of the measurement, which _matrix reports.
Matrix = list[list[Annotated[float, Meta(extra=toml.MAY_BE_INFINITE)]]]


@dataclass(frozen=True, eq=False)
class ModalRecord:
    """Identified modes of one device.

    Parameters
    ----------
    name : device id, or the name of the file.
    frequency_hz, zeta : (M,) undamped frequencies [Hz] and damping ratios.
    R1, R0 : (M, S, D) [1/s] and [1/s^2].
    sd : (M, 2, S, D) sd of R1 and of R0 / w [1/s]; ``None`` where the file states none.
    antialias : the filter that the residues contain; ``None`` means no filter.
    rate_dps : declared angular rate [deg/s]; ``None`` means unknown.
    angular_gain, phase_error_deg, drive, reference : as in a campaign.
    """

    name: str
    frequency_hz: FloatArray
    zeta: FloatArray
    R1: FloatArray
    R0: FloatArray
    sd: FloatArray | None = None
    antialias: AntiAlias | None = None
    rate_dps: float | None = None
    angular_gain: float | None = None
    phase_error_deg: float = 0.0
    drive: Literal["f1", "f2"] = "f1"
    reference: dict[str, tuple[float, float]] = field(default_factory=dict)


class ModeTable(msgspec.Struct, forbid_unknown_fields=True):
    """One [[mode]] table: R1 (S, D) [1/s], R0 (S, D) [1/s^2]; sd is [sd of R1, sd of R0 / w] [1/s]."""

    frequency_hz: Annotated[Positive, Meaning("undamped frequency")]
    zeta: Annotated[float, Meta(gt=0.0, lt=1.0), Meaning("damping ratio", "1")]
    R1: Annotated[Matrix, Meaning("residue at s, rows are senses and columns drives", "1/s")]
    R0: Annotated[Matrix, Meaning("constant residue, of the same shape", "1/s^2")]
    sd: Annotated[
        Annotated[list[Matrix], Meta(min_length=2, max_length=2)] | None,
        Meaning("[sd of R1, sd of R0 / w], each of the same shape; absent: a common unknown relative sd", "1/s"),
    ] = None


class ModalTable(msgspec.Struct, forbid_unknown_fields=True):
    """The whole file; ``rate_dps`` is the angular rate [deg/s]."""

    kind: Annotated[Literal["modal"], Meaning("marks the file as a modal record")]
    mode: Annotated[list[ModeTable], Meta(min_length=1), Meaning("the modes, one table each")]
    name: Annotated[str | None, Meaning("name of the device; absent: device.id, else the file")] = None
    rate_dps: Annotated[float | None, Meaning("constant angular rate during the measurement; absent: unknown")] = None
    antialias: Annotated[
        AntiAliasTable | Literal[False] | None, Meaning("filter that the residues contain; absent or false: none")
    ] = None
    device: Annotated[DeviceTable, Meaning("the device")] = DeviceTable()
    demodulation: Annotated[DemodulationTable, Meaning("how the rate signal is demodulated")] = DemodulationTable()
    reference: References = {}


class _Kind(msgspec.Struct):
    kind: Any = None


def _matrix(rows: Matrix, shape: tuple[int, int] | None, what: str, where: str) -> FloatArray:
    widths = {len(row) for row in rows}
    if len(widths) != 1 or 0 in widths or (shape is not None and (len(rows), *widths) != shape):
        wanted = f"{shape[0]} rows of {shape[1]}" if shape else "rows S1, S2, .. of equal length, one value per drive"
        raise MeasurementError(
            f"{where}: {what} has the wrong shape", value=rows, allowed=wanted, next_step=f"correct {what}"
        )
    matrix = np.array(rows, dtype=np.float64)
    if not np.all(np.isfinite(matrix)):
        raise MeasurementError(
            f"{where}: {what} contains values that are not finite",
            value=rows,
            allowed="finite numbers",
            next_step=f"correct {what}",
        )
    return matrix


def _deviations(modes: list[ModeTable], shape: tuple[int, int], where: str) -> FloatArray | None:
    stated = [mode.sd for mode in modes]
    if all(sd is None for sd in stated):
        return None
    if any(sd is None for sd in stated):
        raise MeasurementError(
            f"{where}: some modes have an sd and some have none",
            value=[sd is not None for sd in stated],
            allowed="sd for all modes or for none",
            next_step="add the missing sd, or remove all",
        )
    sd = np.array([[_matrix(part, shape, "sd", where) for part in pair] for pair in stated if pair is not None])
    if np.any(sd <= 0.0):
        raise MeasurementError(
            f"{where}: an sd is not positive",
            value=float(sd.min()),
            allowed="positive numbers [1/s]",
            next_step="correct sd",
        )
    return sd


def decode_modal_record(text: bytes, path: Path) -> ModalRecord | None:
    """The modal record in ``text``; ``None`` if the TOML does not state ``kind = "modal"``.

    Raises
    ------
    ConfigError : wrong TOML or keys.
    MeasurementError : matrices of different shapes, or values that are not finite or not positive.
    """
    if toml.decode(text, _Kind, path.name).kind != "modal":
        return None
    document = toml.decode(text, ModalTable, path.name)
    modes, where = document.mode, path.name
    first = _matrix(modes[0].R1, None, "R1 of mode 1", where)
    shape = (first.shape[0], first.shape[1])
    name = document.name or document.device.id or path.stem
    return ModalRecord(
        name=name,
        frequency_hz=np.array([mode.frequency_hz for mode in modes]),
        zeta=np.array([mode.zeta for mode in modes]),
        R1=np.array([_matrix(mode.R1, shape, f"R1 of mode {k}", where) for k, mode in enumerate(modes, 1)]),
        R0=np.array([_matrix(mode.R0, shape, f"R0 of mode {k}", where) for k, mode in enumerate(modes, 1)]),
        sd=_deviations(modes, shape, where),
        antialias=document.antialias.built() if document.antialias else None,
        rate_dps=document.rate_dps,
        angular_gain=document.device.angular_gain,
        phase_error_deg=document.demodulation.phase_error_deg,
        drive=document.demodulation.drive,
        reference=references(document.reference, where),
    )


def read_modal_record(path: Path) -> ModalRecord:
    """The modal record in the TOML file ``path``.

    Raises
    ------
    ConfigError : wrong TOML, keys or kind.
    MeasurementError : the file is missing, or its matrices are inconsistent.
    """
    record = decode_modal_record(toml.read_bytes(existing(path)), path)
    if record is None:
        raise ConfigError(
            f"{path.name} is not a modal record",
            allowed='kind = "modal" and [[mode]] tables',
            next_step='write kind = "modal" at its top',
        )
    return record


def write_modal_record(record: ModalRecord, path: Path) -> None:
    """Write ``record`` so that :func:`read_modal_record` returns it with every number exact.

    Raises
    ------
    UsageError : the file cannot be written.
    """
    parts = [
        toml.table(
            "",
            {
                "kind": "modal",
                "name": record.name,
                "rate_dps": record.rate_dps,
                "antialias": None if record.antialias is None else record.antialias.table,
            },
        ),
        toml.table("[device]", {"angular_gain": record.angular_gain}),
        toml.table("[demodulation]", {"phase_error_deg": record.phase_error_deg, "drive": record.drive}),
        toml.table("[reference]", {name: list(pair) for name, pair in record.reference.items()}),
    ]
    for m in range(record.frequency_hz.size):
        mode = {
            "frequency_hz": float(record.frequency_hz[m]),
            "zeta": float(record.zeta[m]),
            "R1": record.R1[m].tolist(),
            "R0": record.R0[m].tolist(),
            "sd": None if record.sd is None else record.sd[m].tolist(),
        }
        parts.append(toml.table("[[mode]]", mode))
    try:
        path.write_text("\n".join(part for part in parts if part), encoding="utf-8")
    except OSError as error:
        raise unwritable("the modal record", path, error) from error
