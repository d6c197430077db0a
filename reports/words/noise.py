"""What the records show of their noise, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def noise_words(columns: Mapping[str, Any]) -> str:
    """The noise of one device that is not white, from its columns; empty where it is."""
    parts = []
    if columns.get("noise_colour") == "coloured":
        parts.append("coloured in silence, and the fit is whitened with its spectrum")
    if columns.get("jitter_s"):
        parts.append(f"sampling jitter of {columns['jitter_s'] * 1e9:.3g} ns")
        if columns.get("error_all_noise") is not None:
            parts.append(f"error with it {columns['error_all_noise']:.4f}")
    return ", ".join(parts)


def lot_noise_sentence(colours: Sequence[str], jitter_s: Sequence[float]) -> str:
    """How many devices of a run show noise that is not white: colours of all devices, jitter [s] of those that show it."""
    coloured = sum(colour == "coloured" for colour in colours)
    # Two channels at a false-alarm probability of 1e-3 each (noise.spectrum).
    parts = (
        [f"coloured noise in the silence of {coloured} of {len(colours)} devices (0.2 % by chance)"] if coloured else []
    )
    if jitter_s:
        middle = sorted(jitter_s)[len(jitter_s) // 2]
        parts.append(f"sampling jitter in {len(jitter_s)} of {len(colours)} devices (median {middle * 1e9:.3g} ns)")
    return f"The records show {' and '.join(parts)}." if parts else ""
