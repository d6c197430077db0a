"""A device as a function of independent standard normals.

    z (d,) ~ N(0, I)  --LatentNumbers-->  numbers of all streams, die  --irregularities-->  device

Each device is one draw of the whole hierarchy: a lot, a wafer and a package of its own, on a die that is uniform over the dies
of the wafer.  The distribution of one device is that of ``draw``; devices are independent, which those of a lot are not.

    normal     its own entries of z
    uniform    Phi(z)
    field      at the die of the device: R z, R R^T the correlation there of the fields of all lengths of the stream
    die        the floor(D Phi(z))-th die of the wafer, counted by the distance from its centre
    fixed      those of the seed: all devices share them, so they are no property of a device

Which streams an irregularity reads is recorded by letting it act on one device; no list of them exists.

Shapes: d latent normals, B devices, D dies per wafer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ConfigError, UsageError

from .acting import acted
from .draw import Draw, draw_with, true_with
from .layout import Places, die_centres
from .nominal import Wafer
from .numbers import SeededNumbers, field_factor
from .site import Site
from .spec import PopulationSpec

_DIE = "wafer/die"
_UNIFORM = "/uniform"


@dataclass(frozen=True)
class LatentSpace:
    """The latent normals of a population.

    Parameters
    ----------
    names : of the d entries, "irregularity/level/label" with a number where a stream has several.
    first : stream -> its first entry.
    size : stream -> number of its entries.
    lengths : stream of a field -> correlation lengths [mm] in the order of its entries.
    fixed : irregularities that read numbers which all devices share.
    """

    names: tuple[str, ...]
    first: Mapping[str, int]
    size: Mapping[str, int]
    lengths: Mapping[str, tuple[float, ...]]
    fixed: frozenset[str] = frozenset()

    @property
    def dimension(self) -> int:
        """d."""
        return len(self.names)


class _Recorder:
    """Numbers of one device that remember which streams were read: stream -> size, stream -> lengths of a field."""

    def __init__(self) -> None:
        self.size: dict[str, int] = {}
        self.lengths: dict[str, tuple[float, ...]] = {}
        self.shared: set[str] = set()
        self._numbers = SeededNumbers(0)

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        self.size[stream] = max(size, self.size.get(stream, 0))
        return self._numbers.normal(stream, keys, size)

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        self.size[stream + _UNIFORM] = 1
        return self._numbers.uniform(stream, keys)

    def fixed(self, stream: str, size: int) -> FloatArray:
        self.shared.add(stream.partition("/")[0])
        return self._numbers.fixed(stream, size)

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        known = self.lengths.get(stream, ())
        self.lengths[stream] = known if length_mm in known else (*known, length_mm)
        self.size[stream] = len(self.lengths[stream])
        return self._numbers.field(stream, keys, die, wafer, length_mm)


@dataclass(frozen=True, eq=False)
class LatentNumbers:
    """The numbers of B devices from their latent normals ``z`` (d, B); ``seed`` is that of the fixed ones."""

    space: LatentSpace
    z: FloatArray
    seed: int

    def _entries(self, stream: str, size: int) -> FloatArray:
        if size > self.space.size.get(stream, 0):
            raise _unread(stream)
        first = self.space.first[stream]
        return self.z[first : first + size]

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        """Standard normals (size, B) [1]."""
        return np.ascontiguousarray(self._entries(stream, size))

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        """Uniform numbers (B,) [1] in [0, 1)."""
        return _uniform(self._entries(stream + _UNIFORM, 1)[0])

    def fixed(self, stream: str, size: int) -> FloatArray:
        """Standard normals (size,) [1], the same for all devices."""
        return SeededNumbers(self.seed).fixed(stream, size)

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """The fields of all lengths of the stream are jointly normal at a die; this is the one of ``length_mm``, (B,) [1]."""
        lengths = self.space.lengths.get(stream, ())
        if length_mm not in lengths:
            raise _unread(f"{stream}, {length_mm} mm")
        rows = _field_roots(wafer, lengths)[die, lengths.index(length_mm)]
        return np.asarray(np.sum(rows.T * self._entries(stream, len(lengths)), axis=0))


def _unread(stream: str) -> ConfigError:
    return ConfigError(
        "an irregularity reads other random numbers for some devices than for others",
        value=stream,
        allowed="the same levels, labels, sizes and lengths for all devices",
        next_step="read them always, and use them where needed (docs/how-to/add-an-irregularity.md)",
    )


def _uniform(normal: FloatArray) -> FloatArray:
    # Phi rounds to 1 above 8.3, which is not in [0, 1).
    return np.minimum(ndtr(normal), np.nextafter(1.0, 0.0))


@lru_cache(maxsize=32)
def _field_roots(wafer: Wafer, lengths: tuple[float, ...]) -> FloatArray:
    """Roots R (D, L, L) [1] of the correlation R R^T of the fields of L lengths [mm] at each die.

    It is singular at the first die, where a seeded field is its first normal for any length.
    """
    rows = np.stack([field_factor(wafer, length) for length in lengths], axis=1)
    values, vectors = np.linalg.eigh(rows @ rows.transpose(0, 2, 1))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :], dtype=np.float64)


@lru_cache(maxsize=32)
def _outwards(wafer: Wafer) -> IntArray:
    """The dies (D,) by distance from the centre, then by azimuth: the tail of the latent normal is the edge."""
    centres = die_centres(wafer)
    radius = np.round(np.hypot(centres[:, 0], centres[:, 1]), 9)
    return np.lexsort((np.arctan2(centres[:, 1], centres[:, 0]), radius)).astype(np.int64)


def _places(wafer: Wafer, z: FloatArray) -> Places:
    """Own lots and wafers of B devices, on the dies that ``z`` (B,) chooses."""
    order, centres = _outwards(wafer), die_centres(wafer)
    die = order[(len(order) * _uniform(z)).astype(np.int64)]
    own = np.arange(z.size, dtype=np.int64)
    x, y = np.take(centres[:, 0], die), np.take(centres[:, 1], die)
    return Places(lot=own, wafer=own, wafer_in_lot=np.zeros_like(own), die=die, x_mm=x, y_mm=y)


def latent_space(spec: PopulationSpec) -> LatentSpace:
    """The latent normals of a population, found by recording what its irregularities read.

    Raises
    ------
    ConfigError : an irregularity gives invalid changes.
    """
    recorder, own = _Recorder(), np.zeros(1, dtype=np.int64)
    placed = _places(spec.wafer, np.zeros(1))
    for irregularity, values in spec.found():
        site = Site(irregularity.name, recorder, own, placed, spec.device, spec.wafer, spec.operating)
        acted(irregularity, values, site)
    size = {_DIE: 1, **recorder.size}
    names: list[str] = []
    first: dict[str, int] = {}
    for stream, count in size.items():
        first[stream] = len(names)
        names += [stream] if count == 1 else [f"{stream}[{k}]" for k in range(count)]
    return LatentSpace(tuple(names), first, size, dict(recorder.lengths), frozenset(recorder.shared))


def draw_latent(spec: PopulationSpec, space: LatentSpace, z: FloatArray, seed: int) -> Draw:
    """The B devices whose latent normals are ``z`` (B, d); ``seed`` is that of the numbers all devices share.

    Raises
    ------
    UsageError : ``z`` does not have the shape (B, d) with B of at least 1.
    ConfigError : as :func:`populations.draw.draw`.
    """
    return draw_with(*_latent(spec, space, z, seed))


def true_latent(spec: PopulationSpec, space: LatentSpace, z: FloatArray, seed: int) -> dict[str, FloatArray]:
    """``true`` of :func:`draw_latent` alone, bit for bit, in less than half of its time: what an attribution asks 91 times.

    Raises
    ------
    UsageError : as :func:`draw_latent`.
    ConfigError : as :func:`populations.draw.true_with`.
    """
    return true_with(*_latent(spec, space, z, seed))


def _latent(
    spec: PopulationSpec, space: LatentSpace, z: FloatArray, seed: int
) -> tuple[PopulationSpec, IntArray, Places, LatentNumbers]:
    """The population, device numbers, places and random numbers of devices with the latent normals ``z`` (B, d)."""
    if z.ndim != 2 or z.shape[1] != space.dimension or not len(z):
        allowed = f"(devices, {space.dimension})"
        raise UsageError("the latent normals have another shape", value=z.shape, allowed=allowed)
    columns = np.ascontiguousarray(z.T)
    placed = _places(spec.wafer, columns[space.first[_DIE]])
    return spec, np.arange(len(z), dtype=np.int64), placed, LatentNumbers(space, columns, seed)
