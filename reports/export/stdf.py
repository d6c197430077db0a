"""A lot of a night as an STDF V4 file.

    FAR MIR WCR { WIR { PIR PTR.. PRR } WRR } TSR.. HBR.. SBR.. PCR MRR

- One file per lot, since MIR has one LOT_ID.  Devices without a wafer come first, outside WIR and WRR.
- A test is a result quantity, in its unit (UNITS, RES_SCAL 0); limited quantities have LO_LIMIT, HI_LIMIT and a pass/fail flag by
  their estimate, and their sd follows as a test without limits.  The last test is p_pass, by which the device is judged; the
  verdict is in the bins (see ``bins``).
- RESULT is an IEEE single, 24 bits: 535.6162441 Hz is stored as 535.61627.  CSV, Parquet and Excel hold all digits.
- An axis is given on the branch around the middle of its arc, so that LO_LIMIT <= RESULT <= HI_LIMIT is its test.
- A value that is not known or not finite has TEST_FLG bits 1 and 6; the results of a device that is not ok have bit 2.
- PARM_FLG bits 6, 7: a value at a limit conforms.

Source: Teradyne, STDF Specification, Version 4: field tables, "STDF File Ordering".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.axial import PERIOD_DEG
from pipeline.quantities import QUANTITIES

from ..coded import CodedText, IntArray
from ..devices import Devices
from ..limits import Limit, Limits
from ..yields import natural
from . import stdf_fields as fields
from .bins import HARD_NAMES, PASSING, Bins, bins_of
from .dies import DieGrid, die_grid

_INVALID, _UNRELIABLE, _NO_VERDICT, _FAILED = 0x02, 0x04, 0x40, 0x80
_ABOVE, _BELOW, _AT_LIMIT_PASSES = 0x08, 0x10, 0xC0
_PART_ABNORMAL, _PART_FAILED, _PART_NO_VERDICT = 0x04, 0x08, 0x10
#: TEST_NUM of the first value, of the first sd, and of p_pass.
_VALUES, _SDS, _P_PASS = 1000, 2000, 3000
#: A parametric record without its default data.
_SHORT = np.dtype(
    [("length", "<u2"), ("kind", "u1", 2), ("number", "<u4"), ("place", "u1", 2), ("flags", "u1"), ("parametric", "u1"),
     ("result", "<f4")]
)  # fmt: skip


@dataclass(frozen=True)
class NightIdentity:
    """What MIR and MRR say of a run: times in ISO 8601, names as in the manifest."""

    run_id: str
    created: str
    finished: str | None
    version: str = ""


@dataclass(frozen=True, eq=False)
class StdfTest:
    """One test of all devices: values (B,) in ``unit``, nan where unknown; limits, infinite where there are none."""

    number: int
    name: str
    unit: str
    low: float
    high: float
    values: FloatArray = field(repr=False)

    @property
    def limited(self) -> bool:
        """Whether it has a limit."""
        return math.isfinite(self.low) or math.isfinite(self.high)


@dataclass(frozen=True, eq=False)
class StdfNight:
    """The devices of a run as STDF holds them.

    Parameters
    ----------
    identity : of the run.
    tests : each with its values.
    ids, lots, wafers : of B devices; "" where unknown.
    reasons : why the status is not ok.
    ok : (B,) whether the identification is ok.
    bins, dies : of B devices.
    """

    identity: NightIdentity
    tests: tuple[StdfTest, ...]
    ids: CodedText
    lots: CodedText
    wafers: CodedText
    reasons: CodedText
    ok: BoolArray
    bins: Bins
    dies: DieGrid

    def lot_names(self) -> tuple[str, ...]:
        """The lots, each of which is a file; "" where no lot is known."""
        return tuple(sorted(self.lots.counts(), key=natural))

    def cut_texts(self) -> int:
        """Texts that are longer than a field and are cut: device ids, wafers, lots, reasons."""
        columns = (self.ids, self.lots, self.wafers, self.reasons)
        return sum(n for column in columns for word, n in column.counts().items() if fields.is_cut(word))


def stdf_night(devices: Devices, limits: Limits, identity: NightIdentity) -> StdfNight:
    """The content of the STDF files of a run; columns are read one after the other."""
    return StdfNight(
        identity,
        _tests(devices, limits),
        devices.text("device_id"),
        devices.text("lot"),
        devices.text("wafer"),
        devices.text("status_reason"),
        devices.is_ok(),
        bins_of(devices, limits),
        die_grid(devices.number("die_x_mm"), devices.number("die_y_mm")),
    )


def _tests(devices: Devices, limits: Limits) -> tuple[StdfTest, ...]:
    by_name = {limit.quantity: limit for limit in limits.limits}
    values, sds = [], []
    for k, quantity in enumerate(QUANTITIES):
        found = devices.number(quantity.name)
        if not np.isfinite(found).any():
            continue
        unit, limit = "" if quantity.unit == "1" else quantity.unit, by_name.get(quantity.name)
        if limit is not None and limit.axis:
            found = _on_branch(found, limit)
        low, high = (-math.inf, math.inf) if limit is None else (limit.low, limit.high)
        values.append(StdfTest(_VALUES + k, quantity.name, unit, low, high, found))
        if limit is not None:
            sd = devices.number(f"{quantity.name}_sd")
            sds.append(StdfTest(_SDS + k, f"{quantity.name}_sd", unit, -math.inf, math.inf, sd))
    p_pass = StdfTest(_P_PASS, "p_pass", "", -math.inf, math.inf, devices.number("p_pass"))
    return (*values, *sds, p_pass)


def _on_branch(theta_deg: FloatArray, limit: Limit) -> FloatArray:
    """The axes within a quarter turn of the middle of their arc [deg]."""
    middle = 0.5 * (limit.low + limit.high)
    return np.asarray(middle + np.mod(theta_deg - middle + 0.5 * PERIOD_DEG, PERIOD_DEG) - 0.5 * PERIOD_DEG)


def stdf_chunks(night: StdfNight, lot: str) -> Iterator[bytes]:
    """The file of a lot, wafer by wafer."""
    start, end = _seconds(night.identity.created), _seconds(night.identity.finished or night.identity.created)
    rows = np.flatnonzero(night.lots.equals(lot))
    identity = night.identity
    yield fields.far()
    yield fields.mir(
        start, lot or identity.run_id, "MEMS gyro", identity.run_id, "gyroscreen", identity.version, _REMARK
    )
    if night.dies.known[rows].any():
        yield fields.wcr(*night.dies.pitch_mm)
    wafers = night.wafers.at(rows)
    named = False
    for wafer in sorted(wafers.counts(), key=natural):
        here = rows[wafers.equals(wafer)]
        if wafer:
            yield fields.wir(start, wafer)
        for first in range(0, here.size, _PARTS):
            yield _parts(night, here[first : first + _PARTS], named)
            named = True
        if wafer:
            yield fields.wrr(end, here.size, int(np.sum(night.bins.hard[here] == 1)), wafer)
    yield from (_synopsis(test, rows) for test in night.tests)
    yield from _bin_records(night.bins, rows)
    yield fields.pcr(rows.size, int(np.sum(night.bins.hard[rows] == 1)))
    yield fields.mrr(end)


_REMARK = "RESULT is the estimate; verdicts are in the bins"
#: Parts whose records are in memory together.
_PARTS = 4096


def _parts(night: StdfNight, rows: IntArray, named: bool) -> bytes:
    """PIR, PTRs and PRR of the parts ``rows``; unless ``named``, the first part's PTRs name the tests and their limits."""
    count = len(night.tests)
    short = np.zeros((rows.size, count), dtype=_SHORT)
    short["length"], short["kind"], short["place"] = _SHORT.itemsize - 4, (15, 10), (1, 1)
    short["number"] = [test.number for test in night.tests]
    for k, test in enumerate(night.tests):
        values = test.values[rows]
        short["flags"][:, k], short["parametric"][:, k] = _flags(test, values, night.ok[rows])
        short["result"][:, k] = np.where(_storable(values), values, 0.0)
    data, length, begin = short.tobytes(), count * _SHORT.itemsize, fields.pir()
    flags, hard, soft = _part_flags(night.bins.hard[rows]), night.bins.hard[rows], night.bins.soft[rows]
    known = night.dies.known[rows]
    places = [np.where(known, axis[rows], fields.NO_COORDINATE).tolist() for axis in (night.dies.x, night.dies.y)]
    columns = (flags.tolist(), hard.tolist(), soft.tolist(), *places, night.ids.at(rows), night.reasons.at(rows))
    out = []
    for i, (flag, hard_bin, soft_bin, x, y, part, reason) in enumerate(zip(*columns, strict=True)):
        tests = data[i * length : (i + 1) * length]
        if i == 0 and not named:
            tests = _full(night.tests, short[0])
        out += [begin, tests, fields.prr(flag, count, hard_bin, soft_bin, x, y, part, reason)]
    return b"".join(out)


def _full(tests: Sequence[StdfTest], short: np.ndarray[tuple[int], np.dtype[np.void]]) -> bytes:
    """The parametric records of one part with the default data of their tests."""
    out = []
    for test, one in zip(tests, short, strict=True):
        flags, parametric, result = int(one["flags"]), int(one["parametric"]), float(one["result"])
        out.append(fields.ptr(test.number, flags, parametric, result, test.name, test.low, test.high, test.unit))
    return b"".join(out)


def _storable(values: FloatArray) -> BoolArray:
    return np.isfinite(values) & (np.abs(values) <= fields.LARGEST)


def _flags(test: StdfTest, values: FloatArray, ok: BoolArray) -> tuple[IntArray, IntArray]:
    """TEST_FLG and PARM_FLG (n,) of a test."""
    known = _storable(values)
    above, below = known & (values > test.high), known & (values < test.low)
    judged = known & test.limited
    flags = np.where(known, 0, _INVALID) | np.where(ok, 0, _UNRELIABLE) | np.where(judged, 0, _NO_VERDICT)
    flags |= np.where(above | below, _FAILED, 0)
    parametric = np.where(above, _ABOVE, 0) | np.where(below, _BELOW, 0) | np.where(judged, _AT_LIMIT_PASSES, 0)
    return np.asarray(flags, dtype=np.int64), np.asarray(parametric, dtype=np.int64)


def _part_flags(hard: IntArray) -> IntArray:
    """PART_FLG (n,) by hardware bin."""
    by_bin = np.zeros(max(HARD_NAMES) + 1, dtype=np.int64)
    by_bin[2], by_bin[3], by_bin[4] = _PART_FAILED, _PART_NO_VERDICT, _PART_NO_VERDICT | _PART_ABNORMAL
    return by_bin[hard]


def _synopsis(test: StdfTest, rows: IntArray) -> bytes:
    values = test.values[rows]
    values = values[_storable(values)]
    failed = int(np.sum((values > test.high) | (values < test.low)))
    summary = (values.min(), values.max(), values.sum(), (values**2).sum()) if values.size else (math.nan,) * 4
    return fields.tsr(test.number, rows.size, failed, test.name, *(float(one) for one in summary))


def _bin_records(bins: Bins, rows: IntArray) -> Iterator[bytes]:
    hard, soft = np.bincount(bins.hard[rows]), np.bincount(bins.soft[rows])
    for number, name in HARD_NAMES.items():
        yield fields.bin_record(True, number, int(hard[number]) if number < hard.size else 0, PASSING[number], name)
    for number in np.flatnonzero(soft).tolist():
        yield fields.bin_record(False, number, int(soft[number]), bins.passing(number), bins.soft_names[number])


def _seconds(moment: str) -> int:
    """ISO 8601 as whole seconds since 1970."""
    return int(datetime.fromisoformat(moment).timestamp())
