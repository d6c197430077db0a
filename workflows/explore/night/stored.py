"""A stored run in memory, read once for all sessions and never changed by them.

Shapes: B devices.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.arrays import BoolArray, FloatArray, IntArray
from pipeline.errors import UsageError
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.folders import PREFIX
from pipeline.store.run import open_run
from reports.coded import CodedText
from reports.common_errors import given_common, with_common
from reports.devices import Devices
from reports.limits import Limits
from reports.yields import Yield, natural, yield_of_verdicts

from ...config import RunConfig
from ...screening.inputs import FILE as INPUTS
from ...screening.inputs import read_inputs
from ...screening.lot.device import Source
from ...screening.outcome import config_of_stored
from ...screening.plan import measured_plan
from ...what_if.gate import status_by
from ...what_if.rate import common_rate
from ...what_if.stored import StoredDraws
from .preview import DrawDeviations, Weights, deviations, weights


@dataclass(frozen=True, eq=False)
class KeptDevices(Devices):
    """Devices whose columns are converted once: each movement of a limit asks for a dozen of them.  The arrays are read-only."""

    _numbers: dict[str, FloatArray] = field(default_factory=dict, repr=False)
    _texts: dict[str, CodedText] = field(default_factory=dict, repr=False)

    def number(self, name: str) -> FloatArray:
        """As of ``Devices``."""
        if name not in self._numbers:
            found = super().number(name)
            found.flags.writeable = False
            self._numbers[name] = found
        return self._numbers[name]

    def text(self, name: str, rows: Sequence[int] | None = None) -> CodedText:
        """As of ``Devices``."""
        if rows is not None:
            return super().text(name, rows)
        if name not in self._texts:
            self._texts[name] = super().text(name)
        return self._texts[name]


@dataclass(frozen=True, eq=False)
class NightData:
    """A run.

    Parameters
    ----------
    results, run_id : where it is.
    config : its configuration.
    limits : the limits and the rule by which it was judged.
    devices : its devices table, in memory.
    known : quantities of which it knows something.
    total : its yield, as its report states it.
    """

    results: Path
    run_id: str
    config: RunConfig
    limits: Limits
    devices: Devices
    known: tuple[str, ...]
    total: Yield
    _draws: dict[str, DrawDeviations] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @cached_property
    def device_ids(self) -> tuple[str, ...]:
        """B names."""
        return tuple(self.devices.text("device_id"))

    @cached_property
    def wafers(self) -> CodedText:
        """B names of wafers, unique over lots; "" where unknown."""
        return self.devices.wafers()

    @cached_property
    def wafer_names(self) -> tuple[str, ...]:
        """The names of wafers in their natural order."""
        return tuple(sorted((name for name in self.wafers.counts() if name), key=natural))

    @cached_property
    def has_draws(self) -> bool:
        """Whether verdicts need draws: not by a rule that judges estimates."""
        return not self.limits.rule.by_estimate

    def value(self, quantity: str) -> FloatArray:
        """(B,) estimates; nan where unknown."""
        return self.devices.number(quantity)

    def status(self, limits: Limits) -> CodedText:
        """B statuses by the gate for ``limits``."""
        return status_by(self.devices, self.config, self.limits, limits)

    def on(self, wafer: str) -> BoolArray:
        """(B,) whether a device is of the wafer or lot ``wafer``; "" is all."""
        if not wafer:
            return np.ones(len(self.devices), dtype=np.bool_)
        return self.wafers.equals(wafer) | self.devices.text("lot").equals(wafer)

    def holds(self, quantity: str) -> bool:
        """Whether the limit of ``quantity`` can be previewed without reading its draws first."""
        return not self.has_draws or quantity in self._draws

    def draws(self, *quantities: str) -> dict[str, DrawDeviations]:
        """The draws of ``quantities``, read from disk when they are first asked for."""
        with self._lock:
            missing = tuple(dict.fromkeys(name for name in quantities if name not in self._draws))
            if missing:
                self._draws.update(self._read(missing))
            return {name: self._draws[name] for name in quantities}

    @cached_property
    def weights(self) -> Weights:
        """Weights of the draws by the limits of the run."""
        return weights(self.limits, self.devices.number("p_pass"), self.draws(*self.limits.quantities))

    def _read(self, names: tuple[str, ...]) -> dict[str, DrawDeviations]:
        """The draws of ``names`` in one pass over the files."""
        inputs = open_run(self.results, self.run_id).page(INPUTS)
        rate = common_rate(self.config, inputs, self.run_id)

        def read(tables: StoredRun) -> dict[str, DrawDeviations]:
            stored = StoredDraws(self.config, self.devices, tables.posterior, names, rate)
            batches = stored.batches(np.ones(len(self.devices), dtype=np.bool_))
            return deviations({name: self.value(name) for name in names}, batches, stored.per_device)

        return with_run(self.results, self.run_id, read)

    @cached_property
    def source(self) -> Source:
        """What an examination of one device needs: the configuration, and the campaigns if the devices are measured."""
        data = open_run(self.results, self.run_id).page(INPUTS)
        if self.config.source.kind != "campaigns" or data is None:
            return self.config, {}
        inputs = read_inputs(data, f"{INPUTS} of {self.run_id}")
        folders = [Path(file.path).parent for file in inputs.of("campaign")]
        return self.config, dict(enumerate(measured_plan(self.config, folders, inputs).campaigns))

    def number(self, device_id: str) -> int | None:
        """The row of a device; ``None`` if there is no such device."""
        return self._rows.get(device_id)

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.device_ids)}


def load(folder: Path) -> NightData:
    """The run in ``folder``.

    Raises
    ------
    UsageError : it has no devices.
    IntegrityError : a file is not what was committed.
    """
    results, run_id = folder.parent, folder.resolve().name.removeprefix(PREFIX)

    def read(tables: StoredRun) -> NightData:
        config = config_of_stored(results, tables)
        table = pa.Table.from_batches(tables.devices.to_batches(), schema=tables.devices.schema).combine_chunks()
        devices = KeptDevices(table)
        if not len(devices):
            raise UsageError("the run holds no device", value=run_id, next_step="gyroscreen run --resume continues it")
        limits = config.judged_by()
        draws = StoredDraws(config, devices, tables.posterior, limits.quantities, None)
        total = with_common(
            yield_of_verdicts(devices.text("verdict")), given_common(devices, tables.posterior, limits.rule)
        )
        return NightData(results, run_id, config, limits, devices, draws.known(), total)

    night = with_run(results, run_id, read)
    if night.has_draws and night.known:
        _ = night.weights
    return night


def codes_of(verdicts: CodedText, words: tuple[str, ...]) -> IntArray:
    """(B,) place of each verdict in ``words``, 0 for any other."""
    place = np.array([words.index(word) if word in words else 0 for word in (*verdicts.words, "")], dtype=np.int64)
    return place[verdicts.codes]
