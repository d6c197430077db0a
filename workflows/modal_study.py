"""The documented import of this study; the code is in ``studies.modal``."""

from .studies.modal import rungs_by_chance

__all__ = ["rungs_by_chance"]
