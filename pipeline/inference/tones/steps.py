"""Steps of central differences by the parameters of a model."""

from __future__ import annotations

from collections.abc import Mapping

from ...device.model import Model

#: Steps: of a frequency and a damping ratio in half-widths, of other parameters relative to themselves.
_STEP, _RELATIVE = 1e-3, 1e-5


def damping_names(model: Model) -> dict[str, str]:
    """Name of the frequency of each mode -> that of its damping ratio."""
    names = model.by_name
    plant = {n: f"zeta{n[1:-3]}" for n in names if n.endswith("_hz") and f"zeta{n[1:-3]}" in names}
    added = (effect.mode for effect in model.ordered_effects())
    return plant | {mode[0]: mode[1] for mode in added if mode is not None}


def difference_step(zetas: Mapping[str, str], name: str, values: Mapping[str, float], size: float) -> float:
    """Step at ``values``; ``zetas`` of ``damping_names``, ``size`` a typical value of the parameter."""
    at = abs(values.get(name, 0.0))
    if name in zetas:
        return _STEP * max(values.get(zetas[name], 1.0), 1e-9) * at
    if name in zetas.values():
        return _STEP * max(at, 1e-9)
    return max(_RELATIVE * at, 0.1 * size)
