"""Shapes and types of the changes that irregularities make, and their check.  Shapes: B devices, J springs."""

from __future__ import annotations

import numpy as np

from pipeline.errors import ConfigError

from .irregularity import CHANGES, Change

COMPLEX = frozenset({"anisotropy", "post_offset_mm", "damping_anisotropy"})
ROWS = {"ln_area": 4, "ln_gap": 4, "ln_arm": 4, "ln_channel": 4, "ln_gas": 2}


def change_shapes(count: int, springs: int) -> dict[str, tuple[int, ...]]:
    """The shape of each field of a ``Change`` of ``count`` devices with ``springs`` springs."""
    rows = {**ROWS, "ln_spring": springs, "azimuth_rad": springs}
    return {name: (rows[name], count) if name in rows else (count,) for name in CHANGES}


def check_change(source: str, change: Change, count: int, springs: int) -> None:
    """Check the changes of the irregularity ``source`` for ``count`` devices with ``springs`` springs.

    Raises
    ------
    ConfigError : a change has the wrong shape, is complex instead of real, or is not finite.
    """
    shape = change_shapes(count, springs)
    for name in CHANGES:
        part = getattr(change, name)
        if part is None:
            continue
        complex_for_real = np.iscomplexobj(part) and name not in COMPLEX
        if np.shape(part) != shape[name] or complex_for_real or not np.all(np.isfinite(part)):
            raise ConfigError(
                f"irregularity {source}: {name} has the wrong shape or type, or is not finite",
                value=np.shape(part),
                allowed=f"finite {'complex' if name in COMPLEX else 'real'} numbers of shape {shape[name]}",
                next_step="correct act() of the irregularity, or the values of its parameters",
            )
