"""Content of the query views besides the tables: ``run_id``, the runs, and the columns with their units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, replace

import pyarrow as pa

from .irregularity_table import IRREGULARITIES
from .manifest import Kind, Manifest
from .schema import COLUMNS, Column, arrow_schema

_RUN_ID = Column("runs", "run_id", "string", "", "name of the run")

RUNS: tuple[Column, ...] = (
    _RUN_ID,
    Column("runs", "status", "string", "", "running, stopped or complete; a killed run stays running"),
    Column("runs", "created", "string", "", "when it was created, ISO 8601, UTC"),
    Column("runs", "finished", "string", "", "when it was finished, ISO 8601, UTC"),
    Column("runs", "devices", "int64", "1", "committed devices"),
    Column("runs", "draws", "int64", "1", "committed posterior draws"),
    Column("runs", "blocks", "int64", "1", "committed blocks"),
    Column("runs", "seed", "string", "", "root seed of all random streams"),
    Column("runs", "version", "string", "", "version of gyroscreen that wrote it"),
    Column("runs", "git_revision", "string", "", "git revision of the checkout"),
    Column("runs", "config_sha256", "string", "", "SHA-256 of run.toml"),
    Column("runs", "devices_digest", "string", "", "digest of the values of its devices table"),
)

_META: tuple[Column, ...] = (
    Column("columns", "table", "string", "", "view that has the column"),
    Column("columns", "name", "string", "", "name of the column"),
    Column("columns", "type", "string", "", "type of its values"),
    Column("columns", "unit", "string", "", "unit of its values, 1 for a pure number"),
    Column("columns", "meaning", "string", "", "what it is"),
)

#: The columns of all tables of a run.
_REGISTERED: tuple[Column, ...] = (*COLUMNS, *IRREGULARITIES)


def view_schema(kind: Kind) -> pa.Schema:
    """Schema of the view of a table: ``run_id``, then the registered columns."""
    return arrow_schema((_RUN_ID, *(column for column in _REGISTERED if column.table == kind)))


def columns_view() -> pa.Table:
    """Every column of every view, with unit and meaning."""
    run_ids = tuple(replace(_RUN_ID, table=table) for table in dict.fromkeys(c.table for c in _REGISTERED))
    rows = [astuple(column) for column in (*run_ids, *_REGISTERED, *RUNS, *_META)]
    return pa.table([pa.array(values, pa.string()) for values in zip(*rows)], schema=arrow_schema(_META))


def runs_view(manifests: Sequence[Manifest]) -> pa.Table:
    """One row a run, with the columns ``RUNS``, in the order of ``manifests``."""
    rows = [
        (
            m.run_id,
            m.status,
            m.created,
            m.finished,
            m.rows("devices"),
            m.rows("posterior"),
            len(m.blocks()),
            _text(m.provenance.get("seed")),
            _text(m.provenance.get("versions", {}).get("gyroscreen")),
            _text(m.provenance.get("git_revision")),
            m.config_sha256,
            m.devices_digest,
        )
        for m in manifests
    ]
    schema = arrow_schema(RUNS)
    return pa.table([pa.array(values, kind) for values, kind in zip(zip(*rows), schema.types)], schema=schema)


def _text(value: object) -> str | None:
    return None if value is None else str(value)
