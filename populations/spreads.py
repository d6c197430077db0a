"""Which random numbers a parameter of a population spreads.

A parameter is a spread of a set of numbers z where a change of the parameter by a factor s is the same as z -> s z, for every z.
Which numbers these are is found by letting the irregularity act on a few devices: no list of spreads exists, and a parameter of a
new irregularity needs no entry.  A mean, a correlation or a share of leaking lids is no spread.

Shapes: d latent normals, B devices.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ConfigError

from .irregularity import CHANGES, Change, Irregularity
from .latent import LatentNumbers, LatentSpace, latent_space
from .layout import places
from .site import Site
from .spec import PopulationSpec

#: So many that a share of 1 % acts on some of them.
_DEVICES, _FACTOR = 512, 0.75


def spread_numbers(spec: PopulationSpec, irregularity: str, parameter: str) -> IntArray | None:
    """Entries of the latent normals (``latent_space``) that a parameter spreads; ``None`` where it is no spread.

    A value that is zero spreads nothing that could be scaled: ``None``, too.
    """
    try:
        return _spread(spec, irregularity, parameter)
    except ConfigError:  # the parameter is the length of a field, of which other numbers would be read
        return None


def _spread(spec: PopulationSpec, irregularity: str, parameter: str) -> IntArray | None:
    own, values = next((one, values) for one, values in spec.found() if one.name == irregularity)
    space = latent_space(spec)
    if not values[parameter]:
        return None
    changed = {**values, parameter: _FACTOR * values[parameter]}
    z = np.random.Generator(np.random.PCG64(0)).standard_normal((space.dimension, _DEVICES))

    def same(before: FloatArray, after: FloatArray) -> bool:
        return _equal(_acted(spec, own, values, space, before), _acted(spec, own, changed, space, after))

    nothing = np.zeros_like(z)
    if not same(nothing, nothing):
        return None
    found: list[int] = []
    for stream in (name for name in space.first if name.startswith(f"{irregularity}/")):
        rows = np.arange(space.first[stream], space.first[stream] + space.size[stream])
        alone = nothing.copy()
        alone[rows] = z[rows]
        if not same(alone, alone):
            found += rows.tolist()
    entries = np.array(found, dtype=np.int64)
    scaled = z.copy()
    scaled[entries] *= _FACTOR
    return entries if entries.size and same(scaled, z) else None


def _acted(
    spec: PopulationSpec, own: Irregularity, values: Mapping[str, float], space: LatentSpace, z: FloatArray
) -> Change:
    index = np.arange(_DEVICES, dtype=np.int64)
    numbers = LatentNumbers(space, z, 0)
    return own.act(
        values, Site(own.name, numbers, index, places(spec.wafer, index), spec.device, spec.wafer, spec.operating)
    )


def _equal(one: Change, other: Change) -> bool:
    for name in CHANGES:
        a, b = getattr(one, name), getattr(other, name)
        if (a is None) != (b is None):
            return False
        if a is not None and not np.allclose(a, b, rtol=1e-9, atol=1e-12 * float(np.max(np.abs(a), initial=0.0))):
            return False
    return True
