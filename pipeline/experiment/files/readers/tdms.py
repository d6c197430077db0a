"""TDMS (LabVIEW), through npTDMS, an extra: ``pip install "gyroscreen[tdms]"``."""

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


class _Doubt(logging.Handler):
    """npTDMS logs what it guesses about damaged files, and reads on; a guess is no measurement."""

    def emit(self, record: logging.LogRecord) -> None:
        raise ValueError(record.getMessage())


@contextmanager
def _doubts_are_errors(library: Any) -> Iterator[None]:
    logger, console, doubt = logging.getLogger("nptdms"), library.log.log_manager.console_handler, _Doubt()
    level = console.level
    console.setLevel(logging.CRITICAL)
    logger.addHandler(doubt)
    try:
        yield
    finally:
        logger.removeHandler(doubt)
        console.setLevel(level)


def read(path: Path) -> Columns:
    """Channels of the one group that the file holds; ``time_s`` from the waveform increment where no channel
    has it.
    """
    # The file is opened here, since the library leaves its own open where it fails.
    library = _library()
    with path.open("rb") as stream, _doubts_are_errors(library), library.TdmsFile.open(stream) as file:
        groups = [group for group in file.groups() if group.channels()]
        if len(groups) != 1:
            raise MeasurementError(
                "a TDMS record is one group",
                value=[group.name for group in groups],
                allowed="one group with channels",
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
    """One group named ``record``."""
    library = _library()
    with library.TdmsWriter(path) as writer:
        writer.write_segment([library.ChannelObject("record", name, values) for name, values in columns.items()])
