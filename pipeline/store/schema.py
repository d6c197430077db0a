"""The registered schema: the columns of the results tables, their types, units and meanings.

``devices`` has one row a device, ``posterior`` one row a draw.  Columns are only ever added, so older runs stay readable.

Missing values: NaN and ``None`` both become null.  NaN would invalidate SQL aggregates, while null means
"not known" and is skipped by aggregates.  Infinities are kept: an infinite sd means that the data do not
determine the quantity.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa

from ..errors import IntegrityError, UsageError
from ..quantities import IDENTIFIED, MODEL, QUANTITIES, Quantity
from .column import column_array

TYPES: dict[str, pa.DataType] = {
    "string": pa.string(),
    "float32": pa.float32(),
    "float64": pa.float64(),
    "int32": pa.int32(),
    "int64": pa.int64(),
}


@dataclass(frozen=True)
class Column:
    """One column of a results table; ``type`` is a key of ``TYPES``, ``unit`` is "" for text, "1" for a pure number."""

    table: str
    name: str
    type: str
    unit: str
    meaning: str


def _text(name: str, meaning: str) -> Column:
    return Column("devices", name, "string", "", meaning)


def _number(name: str, unit: str, meaning: str) -> Column:
    return Column("devices", name, "float64", unit, meaning)


def _estimate(quantity: Quantity) -> tuple[Column, ...]:
    q, unit, meaning = quantity.name, quantity.unit, quantity.meaning
    interval = "the 90 % arc, which runs up from q05 to q95 modulo 180 deg" if quantity.axis else "the 90 % interval"
    return (
        _number(q, unit, meaning),
        _number(f"{q}_sd", unit, f"posterior sd of {q}"),
        _number(f"{q}_q05", unit, f"lower end of {interval} of {q}"),
        _number(f"{q}_q95", unit, f"upper end of {interval} of {q}"),
    )


def _virtual(quantity: Quantity) -> tuple[Column, ...]:
    q, unit = quantity.name, quantity.unit
    return (
        _number(f"true_{q}", unit, f"{q} of the virtual device as packaged"),
        _number(f"fab_{q}", unit, f"{q} of the virtual device as fabricated, before packaging"),
    )


def _bound(quantity: Quantity) -> Column:
    meaning = f"95 % bound of the bias of {quantity.name} that one undetected effect of the library can cause"
    return _number(f"{quantity.name}_bias_bound", quantity.unit, meaning)


_ORIGIN = (
    _text("device_id", "name of the device, unique in its run"),
    _text("lot", "lot in which it was made"),
    _text("wafer", "wafer in which it was made"),
    _number("die_x_mm", "mm", "die centre from the wafer centre along x"),
    _number("die_y_mm", "mm", "die centre from the wafer centre along y"),
    _text("package", "package into which it was mounted"),
)

_GAUGE = (
    _text("part", "device that several campaigns of the run measured, as [conditions] of its campaign states"),
    _text("tester", "tester that measured it, likewise"),
    _text("session", "session in which it was measured, likewise"),
)

_MISMATCH = (
    _number(
        "drive_mismatch", "1", "drive imbalance of rocking minus that of the up-down mode, including the up-down tilt"
    ),
    _number("drive_mismatch_sd", "1", "posterior sd of drive_mismatch"),
    _number(
        "sense_mismatch", "1", "sense imbalance of rocking minus that of the up-down mode, including the up-down tilt"
    ),
    _number("sense_mismatch_sd", "1", "posterior sd of sense_mismatch"),
)

_ROUTE = (
    _number("theta_u1_deg", "deg", "theta from the sense direction u1 of rocking mode 1 (the paper's route)"),
    _number("theta_v1_deg", "deg", "theta from the drive direction v1 of rocking mode 1 (the paper's route)"),
    _number("theta_u2_deg", "deg", "theta from the sense direction u2 of rocking mode 2 (the paper's route)"),
    _number("theta_v2_deg", "deg", "theta from the drive direction v2 of rocking mode 2 (the paper's route)"),
    _number("arx_split_hz", "Hz", "split from the ARX poles (the paper's route)"),
)

_QUALITY = (
    _number("error", "1", "rms of (measured - model)/sigma, full band; 1 = explained down to the noise"),
    _number(
        "error_all_noise",
        "1",
        "rms of (measured - model)/noise, full band, with the noise that depends on the signal; judged by the gate",
    ),
    _text("noise_colour", "white or coloured, as silence shows the noise"),
    _number(
        "jitter_s", "s", "sd of the sampling instants, from the residual above the band; null where not significant"
    ),
    _number("gain_noise", "1", "sd of the gain from sample to sample, likewise; at most one of the two is given"),
    _number("relative_error", "1", "rms(measured - model)/rms(measured)"),
    _number("chi2_per_dof", "1", "chi2 of the in-band fit per degree of freedom"),
    _number(
        "theta_bias_bound_deg",
        "deg",
        "upper bound of the bias of theta from an unmodelled effect as large as the residual",
    ),
    _text("closest_effect", "the most significant effect of the library that the fitted model lacks"),
    _number("effect_p_value", "1", "family-wise p-value of closest_effect over the library; small: a misfit"),
    *(_bound(quantity) for quantity in IDENTIFIED),
    _number("rhat", "1", "largest R-hat over the parameters, between independent ensembles"),
    _number("ess", "1", "smallest effective sample size over the parameters"),
    _number("acceptance", "1", "mean acceptance fraction of the sampler"),
)

_DECISION = (
    _number("p_pass", "1", "posterior probability that the device conforms to all limits"),
    _text("verdict", "pass, fail or undecided"),
    _text("failed_limits", "failed limits, comma separated"),
    _text("cause", "main cause of the loss"),
    _text("status", "ok, not_converged, fit_failed or misfit; lost: the device ended its worker or ran out of time"),
    _text("status_reason", "why the status is not ok"),
    _text("reference", "reference values compared with the posterior, as quantity z=difference/combined sd"),
)

_TRIM = (
    _text("trim_voltages_v", "trim voltages in the order of the electrodes, comma separated [V]; null without [trim]"),
    _number("trim_at_limit", "1", "1 where a trim voltage is at its limit, else 0"),
    _number("trimmed_theta_deg", "deg", "predicted theta after the trim, including the uncertainty of the gains"),
    _number("trimmed_theta_deg_sd", "deg", "standard deviation of trimmed_theta_deg"),
    _number("trimmed_split_hz", "Hz", "predicted split after the trim, including the uncertainty of the gains"),
    _number("trimmed_split_hz_sd", "Hz", "standard deviation of trimmed_split_hz"),
    _number("trimmed_p_pass", "1", "predicted probability of conformity after the trim"),
    _text("trimmed_verdict", "predicted verdict after the trim"),
    _number("trimmed_true_split_hz", "Hz", "true split after the trim, with the true gains of its electrodes"),
    _number("trimmed_true_theta_deg", "deg", "true theta after the trim"),
    _number("trimmed_true_conforms", "1", "1 where the true device conforms to all limits after the trim, else 0"),
)

_MISSING = (
    _text(
        "missing_effect",
        "effects missing from its model: joined by +, members of one class by |, or unknown; null: none",
    ),
    _text("missing_effect_size", "fitted sizes of these effects, as parameter=value+-sd"),
    _text("missing_effect_reason", "finding of the examination after the last block"),
    _text("status_with_effects", "status with the effects that its lot needs in the model; null if not refitted"),
    _number("p_pass_with_effects", "1", "probability of conformity with the effects that its lot needs in the model"),
    _text("verdict_with_effects", "verdict with the effects that its lot needs in the model"),
)

DEVICES: tuple[Column, ...] = (
    *_ORIGIN,
    *_GAUGE,
    *(column for quantity in QUANTITIES for column in _estimate(quantity)),
    *_MISMATCH,
    *_ROUTE,
    *_QUALITY,
    *_DECISION,
    *_TRIM,
    *_MISSING,
    *(column for quantity in QUANTITIES for column in _virtual(quantity)),
)

POSTERIOR: tuple[Column, ...] = (
    Column("posterior", "device_id", "string", "", "name of the device"),
    Column("posterior", "draw", "int32", "1", "number of the draw, from 0, after thinning"),
    *(Column("posterior", quantity.name, "float64", quantity.unit, quantity.meaning) for quantity in MODEL),
    Column(
        "posterior",
        "p_pass_given_common",
        "float64",
        "1",
        "probability of conformity if the errors of the tester were those with the number of this draw; the same number means"
        " the same errors for all devices; null without [systematic]",
    ),
)

COLUMNS: tuple[Column, ...] = DEVICES + POSTERIOR


def arrow_schema(columns: Sequence[Column]) -> pa.Schema:
    """Arrow schema of columns, in order, nullable, with unit and meaning in the field metadata."""
    return pa.schema(
        [
            pa.field(column.name, TYPES[column.type], metadata={"unit": column.unit, "meaning": column.meaning})
            for column in columns
        ]
    )


@cache
def devices_schema() -> pa.Schema:
    """Registered schema of ``devices``."""
    return arrow_schema(DEVICES)


@cache
def posterior_schema() -> pa.Schema:
    """Registered schema of ``posterior``."""
    return arrow_schema(POSTERIOR)


def devices_table(columns: Mapping[str, Sequence[Any] | np.ndarray[Any, Any] | None]) -> pa.Table:
    """Build a ``devices`` table from column name -> (n,) values, one row a device; raises as :func:`build_table`."""
    return build_table(columns, DEVICES, devices_schema())


def posterior_table(columns: Mapping[str, Sequence[Any] | np.ndarray[Any, Any] | None]) -> pa.Table:
    """Build a ``posterior`` table from column name -> (n,) values, one row a draw; raises as :func:`build_table`."""
    return build_table(columns, POSTERIOR, posterior_schema())


def build_table(
    values: Mapping[str, Sequence[Any] | np.ndarray[Any, Any] | None], columns: Sequence[Column], schema: pa.Schema
) -> pa.Table:
    """Build a table in the registered schema.

    Parameters
    ----------
    values : column name -> (n,) values in the unit of the column; an absent column, or ``None``, is null throughout.
        NaN becomes null.
    columns, schema : registered columns, and their :func:`arrow_schema`.

    Raises
    ------
    UsageError : a name that is not registered, lengths that differ, a value of the wrong type, no device_id.
    """
    registered = {column.name: column for column in columns}
    for name in values:
        if name not in registered:
            raise UsageError(
                f"{columns[0].table} has no such column",
                value=name,
                allowed="the names in pipeline.store.schema.COLUMNS",
                next_step="add it to pipeline/store/schema.py, with unit and meaning, or leave it out",
            )
    ids = values.get("device_id")
    if ids is None or any(name is None for name in ids):
        raise UsageError("every row needs a device_id", next_step="give the column device_id, without gaps")
    rows = len(ids)
    return pa.table(
        [column_array(values.get(name), field.type, rows, name) for name, field in zip(schema.names, schema)],
        schema=schema,
    )


def require_schema(table: pa.Table, schema: pa.Schema, where: str) -> None:
    """Raise IntegrityError unless the columns of the table have the registered names and types, in order."""
    if table.schema.names == schema.names and table.schema.types == schema.types:
        return
    found = dict(zip(table.schema.names, table.schema.types))
    differing = sorted(
        {name for name in schema.names if found.get(name) != schema.field(name).type}
        | (found.keys() - set(schema.names))
    )
    raise IntegrityError(
        f"{where} is not in the registered schema",
        value=differing or "order of the columns",
        allowed=f"{len(schema)} columns as in the view `columns`",
        next_step="build tables with pipeline.store.schema.devices_table or posterior_table",
    )


def duplicates(devices: pa.Table) -> tuple[str, ...]:
    """Names of the devices that have more than one row, sorted."""
    names = devices.column("device_id").to_pylist()
    if len(set(names)) == len(names):
        return ()
    return tuple(sorted(name for name, times in Counter(names).items() if times > 1))
