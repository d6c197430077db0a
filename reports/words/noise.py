"""What the records show of their noise, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.arrays import FloatArray

from ..coded import coded

Floats = Sequence[float] | FloatArray


def noise_words(columns: Mapping[str, Any]) -> str:
    """The noise of one device that is not white, from its columns; empty where it is."""
    parts = []
    if columns.get("noise_colour") == "coloured":
        parts.append("coloured in silence, and the fit is whitened with its spectrum")
    dependent = []
    if columns.get("jitter_s"):
        dependent.append(f"sampling jitter of {columns['jitter_s'] * 1e9:.3g} ns")
    if columns.get("gain_noise"):
        dependent.append(f"gain noise of {columns['gain_noise'] * 1e6:.3g} ppm from sample to sample")
    if dependent and columns.get("error_all_noise") is not None:
        dependent.append(f"error with it {columns['error_all_noise']:.4f}")
    parts += dependent
    return ", ".join(parts)


def lot_noise_sentence(colours: Sequence[str], jitter_s: Floats, gain_noise: Floats = ()) -> str:
    """How many devices of a run show noise that is not white.

    Parameters
    ----------
    colours : of all devices.
    jitter_s, gain_noise : jitter [s] and gain noise [1] of the devices that show it.
    """
    coloured = int(np.sum(coded(colours).equals("coloured")))
    # Two channels at a false-alarm probability of 1e-3 each (noise.spectrum).
    parts = (
        [f"coloured noise in the silence of {coloured} of {len(colours)} devices (0.2 % by chance)"] if coloured else []
    )
    if len(jitter_s):
        middle = np.sort(jitter_s)[len(jitter_s) // 2]
        parts.append(f"sampling jitter in {len(jitter_s)} of {len(colours)} devices (median {middle * 1e9:.3g} ns)")
    if len(gain_noise):
        middle = np.sort(gain_noise)[len(gain_noise) // 2]
        parts.append(f"gain noise in {len(gain_noise)} of {len(colours)} devices (median {middle * 1e6:.3g} ppm)")
    return f"The records show {' and '.join(parts)}." if parts else ""
