"""Colours of the residual before and after effects were added."""

from __future__ import annotations

BEFORE, AFTER = "#d55e00", "#0072b2"
