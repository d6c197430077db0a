"""Colours of what a model left before, and of what is left after effects were added."""

from __future__ import annotations

BEFORE, AFTER = "#d55e00", "#0072b2"
