"""Stored posterior draws of a run as draws of any quantity, in batches of devices.

The draws of the parameters are stored; the others follow from them and from what the run declares, as in the run.  Draw i of a
device stands for draw kept_i of its chains, and so for node kept_i of the common errors (``pipeline.inference.systematic``).  A
quantity that needs more than is stored (the noise of each device, campaigns that declare different operation) is drawn from a
normal distribution with its estimate and sd instead, independent of the others; so are all of them where no draws are stored.

A device whose chains were run longer, because the proposal did not suit its posterior, has other nodes.  Phase error and angular
gain are independent of its draws, so that any nodes serve.

Shapes: b devices, n draws, K common errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
from scipy.special import ndtri

from pipeline.arrays import BoolArray, FloatArray, IntArray
from pipeline.device.gyro import PHYSICAL
from pipeline.device.operation.bias import rate_biases_dps
from pipeline.inference.estimate import RateSettings, quantities
from pipeline.inference.systematic import common_nodes, demodulated
from pipeline.performance.figure import find_figures
from pipeline.quantities import DERIVED, MODEL, NAMES
from pipeline.store.column import number_values, text_codes
from reports.devices import ColumnSource, Devices
from reports.what_if.draws import DrawBatch

from ..config import RunConfig

#: Rows of the posterior table that are judged together: 26 MB of parameters.
_ROWS = 250_000
#: Normal draws of a quantity without stored ones: P(conform) in steps of 1/200, a tenth of the rule's 0.05.
_NORMAL_DRAWS = 200
_SEED = 31
_STORED = tuple(quantity.name for quantity in MODEL)
_QUALITY = {f"quality{i}": f"zeta{i}" for i in (1, 2, 3)}
_OF_BIASES = ["f1_hz", "f2_hz", "zeta1", "zeta2", "theta_deg", "c12_per_s"]
_BIASES = tuple(quantity.name for quantity in DERIVED if quantity.name not in _QUALITY)


@dataclass(frozen=True, eq=False)
class StoredDraws:
    """The draws of a run.

    Parameters
    ----------
    config : of the run.
    devices : its devices table.
    posterior : its posterior table.
    names : the quantities that are wanted.
    rate : what the devices declare about operation; ``None`` where they differ: biases and figures are then drawn from a normal.
    """

    config: RunConfig
    devices: Devices
    posterior: ColumnSource
    names: tuple[str, ...]
    rate: RateSettings | None

    @cached_property
    def per_device(self) -> int:
        """Largest number of stored draws of a device; 0: none are stored."""
        total = self.posterior.num_rows
        return 0 if total == 0 else int(max(number_values(self.posterior["draw"]).max(), 0)) + 1

    @cached_property
    def normal(self) -> tuple[str, ...]:
        """The wanted quantities that are drawn from a normal distribution."""
        return tuple(name for name in self.names if not self._from_draws(name))

    def _from_draws(self, name: str) -> bool:
        if self.per_device == 0:
            return False
        if name in _STORED or name in _QUALITY:
            return True
        if self.rate is None:
            return False
        if name in _BIASES:
            return self.rate.angular_gain is not None
        return not find_figures()[name].missing(self.rate.point)

    def absent(self) -> tuple[str, ...]:
        """The wanted quantities of which the run knows nothing."""
        ok = self.devices.is_ok()
        return tuple(q for q in self.names if ok.any() and not np.isfinite(self.devices.number(q)[ok]).any())

    def known(self) -> tuple[str, ...]:
        """All quantities of which the run knows something."""
        return tuple(q for q in NAMES if np.isfinite(self.devices.number(q)).any())

    def chain_draws(self) -> int:
        """Number of draws of a device, of which some are stored."""
        chains = self.config.posterior
        return chains.ensembles * chains.walkers * chains.steps

    def nodes(self, count: int) -> FloatArray:
        """Common errors (count, 5) [sd] of the stored draws."""
        total = max(self.chain_draws(), count)
        kept = np.linspace(0, total - 1, count).round().astype(np.int64)
        return np.asarray(common_nodes(total)[kept])

    def batches(self, wanted: BoolArray) -> Iterator[DrawBatch]:
        """Draws of the wanted quantities of the devices ``wanted`` (B,)."""
        if self.per_device == 0:
            for rows in np.array_split(np.flatnonzero(wanted), max(1, int(wanted.sum()) * _NORMAL_DRAWS // _ROWS)):
                if rows.size:
                    yield DrawBatch(rows, {q: self.normal_draws(q, rows, _NORMAL_DRAWS) for q in self.names})
            return
        for rows, stored in self._stored(wanted):
            values = self._derived(stored)
            count = next(iter(stored.values())).shape[1]
            values |= {q: self.normal_draws(q, rows, count) for q in self.normal}
            yield DrawBatch(rows, {name: values[name] for name in self.names})

    def physical_batches(self, wanted: BoolArray) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
        """Rows (b,), stored parameters (b, n, 12) and splits (b, n) [Hz] of the devices ``wanted`` (B,)."""
        for rows, stored in self._stored(wanted, (*PHYSICAL, "split_hz")):
            yield rows, _physical(stored, PHYSICAL), stored["split_hz"]

    def _columns(self) -> tuple[str, ...]:
        """The stored columns from which the wanted quantities follow."""
        drawn = [name for name in self.names if name not in self.normal]
        if any(name in find_figures() for name in drawn):
            return (*PHYSICAL, "split_hz")
        found = [_QUALITY.get(name, name) for name in drawn if name not in _BIASES]
        found += _OF_BIASES if any(name in _BIASES for name in drawn) else []
        return tuple(dict.fromkeys(found)) or ("split_hz",)

    def _derived(self, stored: dict[str, FloatArray]) -> dict[str, FloatArray]:
        values = stored | {name: 0.5 / stored[zeta] for name, zeta in _QUALITY.items() if zeta in stored}
        rest = [name for name in self.names if name not in values and name not in self.normal]
        rate = self.rate
        if not rest or rate is None or rate.angular_gain is None:
            return values
        if not rate.systematic.exact:
            rate = demodulated(rate, self.nodes(next(iter(stored.values())).shape[1]))
        if any(name in find_figures() for name in rest):
            return values | quantities(_physical(stored, PHYSICAL), rate, stored["split_hz"])
        # The biases follow from the two rocking modes; the up-down mode only fills its places.
        physical = _physical({"f3_hz": stored["f1_hz"], "zeta3": stored["zeta1"], **stored}, PHYSICAL[:8])
        assert rate.angular_gain is not None  # without one, biases are not derived
        return values | rate_biases_dps(physical, rate.angular_gain, rate.phase_error_deg, rate.drive)

    def normal_draws(self, name: str, rows: IntArray, count: int) -> FloatArray:
        """Draws (b, count) of a quantity from the normal distribution with its estimate and sd; any call gives the same."""
        random = np.random.default_rng(np.random.SeedSequence(_SEED, spawn_key=(NAMES.index(name), count)))
        level = random.permutation(ndtri((np.arange(count) + 0.5) / count))
        value, sd = self.devices.number(name)[rows], self.devices.number(f"{name}_sd")[rows]
        return np.asarray(value[:, None] + sd[:, None] * level)

    def _stored(
        self, wanted: BoolArray, columns: tuple[str, ...] | None = None
    ) -> Iterator[tuple[IntArray, dict[str, FloatArray]]]:
        """Rows (b,) and stored columns (b, n) of the devices ``wanted``; devices with as many draws are together."""
        place = {name: i for i, name in enumerate(self.devices.text("device_id"))}
        columns = self._columns() if columns is None else columns
        for table in _whole_devices(self.posterior.select(["device_id", *columns]).to_batches()):
            words, codes = text_codes(table["device_id"])
            rows = np.array([place[word] for word in words], dtype=np.int64)[codes]
            first = np.flatnonzero(np.diff(rows, prepend=-1))
            count = np.diff(first, append=rows.size)
            values = {name: number_values(table[name]) for name in columns}
            for n in np.unique(count):
                chosen = first[(count == n) & wanted[rows[first]]]
                if chosen.size:
                    taken = chosen[:, None] + np.arange(n)
                    whole = chosen.size * n == rows.size
                    yield (
                        rows[chosen],
                        {q: v.reshape(-1, n) if whole else v[taken] for q, v in values.items()},
                    )


def _physical(stored: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray:
    """Parameters (b, n, P) of the columns (b, n)."""
    return np.moveaxis(np.stack([stored[name] for name in names]), 0, -1)


def _whole_devices(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    """The rows of ``batches`` in parts of at most about ``_ROWS``, none of which divides a device."""
    waiting: list[pa.RecordBatch] = []
    size = 0
    for batch in batches:
        for start in range(0, batch.num_rows, _ROWS):
            part = batch.slice(start, _ROWS)
            waiting.append(part)
            size += part.num_rows
            if size < _ROWS:
                continue
            table = pa.Table.from_batches(waiting)
            cut = _last_start(table["device_id"])
            if cut:
                yield table.slice(0, cut)
            waiting = list(table.slice(cut).to_batches())
            size = table.num_rows - cut
    if size:
        yield pa.Table.from_batches(waiting)


def _last_start(names: pa.ChunkedArray) -> int:
    """Number of the first row of the last device."""
    _, codes = text_codes(names)
    return int(np.flatnonzero(codes != codes[-1])[-1]) + 1 if (codes != codes[-1]).any() else 0
