"""What identification raises."""

from __future__ import annotations

from ..errors import MeasurementError


class IdentificationError(MeasurementError):
    """A record was read, but the three modes of a gyro could not be found in it."""
