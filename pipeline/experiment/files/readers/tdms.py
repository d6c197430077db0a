"""TDMS (LabVIEW), read with the optional package npTDMS: ``pip install "gyroscreen[tdms]"``."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import MeasurementError
from .table import Columns, allow


def _library() -> Any:
    try:
        import nptdms
    except ImportError as error:
        raise MeasurementError(
            "TDMS files need the npTDMS package",
            allowed="npTDMS 1.10 or later",
            next_step='pip install "gyroscreen[tdms]"',
        ) from error
    return nptdms


class _RaisingHandler(logging.Handler):
    """Raises for every log entry, because npTDMS logs its guesses about damaged files and continues."""

    def emit(self, record: logging.LogRecord) -> None:
        raise ValueError(record.getMessage())


@contextmanager
def _log_entries_raise(library: Any) -> Iterator[None]:
    logger, console, handler = logging.getLogger("nptdms"), library.log.log_manager.console_handler, _RaisingHandler()
    level = console.level
    console.setLevel(logging.CRITICAL)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        console.setLevel(level)


def read(path: Path) -> Columns:
    """Channels (N,) of the only group of the file; without a channel ``time_s``, time follows from the waveform increment [s].

    Raises
    ------
    MeasurementError : not exactly one group with channels, or more values than the file can hold.
    """
    # The file is opened here, because the library does not close it when it fails.
    library = _library()
    with path.open("rb") as stream, _log_entries_raise(library), library.TdmsFile.open(stream) as file:
        groups = [group for group in file.groups() if group.channels()]
        if len(groups) != 1:
            raise MeasurementError(
                "the file must have exactly one group with channels",
                value=[group.name for group in groups],
                allowed="one group per file",
                next_step="write each record to its own file",
            )
        channels = groups[0].channels()
        allow(sum(len(channel) for channel in channels), path.stat().st_size)
        columns = {str(channel.name): np.asarray(channel[:]) for channel in channels}
        steps = {float(channel.properties.get("wf_increment", 0.0)) for channel in channels}
    if "time_s" not in columns and len(steps) == 1 and (step := steps.pop()) > 0.0:
        columns["time_s"] = np.arange(max(len(values) for values in columns.values())) * step
    return columns


def write(path: Path, columns: Columns) -> None:
    """One group named ``record``, one channel per column."""
    library = _library()
    with library.TdmsWriter(path) as writer:
        writer.write_segment([library.ChannelObject("record", name, values) for name, values in columns.items()])
