"""Runs on disk: registered schema, commit protocol, verified reading, locked SQL."""

from .digest import table_digest
from .manifest import FileEntry, Manifest
from .read import RunTables, list_runs, read_run
from .run import RunStore, create_run, open_run
from .schema import COLUMNS, Column, devices_schema, devices_table, posterior_schema, posterior_table

__all__ = [
    "COLUMNS",
    "Column",
    "FileEntry",
    "Manifest",
    "RunStore",
    "RunTables",
    "create_run",
    "devices_schema",
    "devices_table",
    "list_runs",
    "open_run",
    "posterior_schema",
    "posterior_table",
    "read_run",
    "table_digest",
]
