"""The error raised when identification fails."""

from __future__ import annotations

from ..errors import MeasurementError


class IdentificationError(MeasurementError):
    """The record is readable, but the three modes of a gyro were not found in it."""
