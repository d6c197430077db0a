"""What N devices cost, from the rows of the study; and the rows as tables.

    core hours   N t / 3600 s                   t    processor time of a device on a worker
    driver       N / n b                        b    its processor time per block of n devices: dispatch, commit, merging
    feeds        n t / b workers                     beyond them the driver is the slowest
    bytes        N (r + p)                      r, p of a row, and of its posterior draws
    query        N q,   report N h,   memory N m + m0

t, b, r, q, h, m are slopes between the two largest runs, so that what happens once (start of processes, loading of code) is not
counted per device.  Runs with one and with two workers give two values of each: the range.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .points import DEVICE, DRAWS, STUB, STUB_BLOCK, VALUES

Row = Mapping[str, Any]
#: Columns of the tables: heading, and the value of a row.
_COLUMNS: dict[str, Callable[[Row], str]] = {
    "varied": lambda row: str(row["kind"]),
    "value": lambda row: f"{row['value']:g}",
    "workers": lambda row: str(row["workers"]),
    "processor time: driver": lambda row: f"{row['run_cpu_s']:.3g} s",
    "workers' processor time": lambda row: f"{row['run_workers_cpu_s']:.3g} s",
    "ms a device": lambda row: f"{1e3 * (row['run_cpu_s'] + row['run_workers_cpu_s']) / row['devices']:.3g}",
    "wall": lambda row: f"{row['run_s']:.3g} s",
    "peak MB: driver, worker": lambda row: f"{row['peak_mb']:.0f}, {row.get('worker_peak_mb', 0.0):.0f}",
    "files": lambda row: str(row.get("files", "")),
    "MB": lambda row: f"{row['bytes'] / 1e6:.3g}" if "bytes" in row else "",
    "close": lambda row: f"{row['close_cpu_s']:.3g} s" if "close_cpu_s" in row else "",
    "query": lambda row: f"{row['query_cpu_s'] + row['query_workers_cpu_s']:.3g} s" if "query_cpu_s" in row else "",
    "report": lambda row: (
        f"{row['report_cpu_s']:.3g} s, {row['report_peak_mb']:.0f} MB" if "report_cpu_s" in row else ""
    ),
}


@dataclass(frozen=True)
class Cost:
    """A figure of a large night: its least and its largest value over the runs that give it."""

    name: str
    low: float
    high: float
    unit: str


def cost_of(rows: Sequence[Row], devices: int) -> list[Cost]:
    """The figures of a night of ``devices`` devices; those whose runs are missing are left out."""
    real = _slopes(rows, DEVICE, "run_workers_cpu_s")
    driver = _slopes(rows, STUB, "run_cpu_s")
    found = [_range("processor time of a device on a worker", real, 1e3, "ms")]
    found.append(_range("core hours", real, devices / 3600.0, "h"))
    found.append(_range(f"driver, of a block of {STUB_BLOCK} stubs", driver, 1e3 * STUB_BLOCK, "ms"))
    found.append(_range("driver, the whole night", driver, devices / 3600.0, "h"))
    fed = [t / b for t in real for b in driver]
    found.append(_range("workers that it feeds", fed, 1.0, ""))
    small = _slopes(rows, DEVICE, "run_cpu_s")
    found.append(_range("driver, blocks of 25 real devices with draws, the whole night", small, devices / 3600.0, "h"))
    found.append(_range("workers that it then feeds", [t / b for t, b in zip(real, small) if b > 0.0], 1.0, ""))
    found.append(_range("rows and draws of real devices", _slopes(rows, DEVICE, "bytes"), devices / 1e9, "GB"))
    found.append(_range("rows", _slopes(rows, STUB, "bytes"), devices / 1e9, "GB"))
    found.append(_range("posterior draws, 100 a device", _of_draws(rows, "bytes"), devices / 1e9, "GB"))
    found.append(_range("driver, for the draws", _of_draws(rows, "run_cpu_s"), devices / 3600.0, "h"))
    for name, key in (("closing", "close_cpu_s"), ("report", "report_cpu_s")):
        found.append(_range(f"{name}, processor time", _slopes(rows, STUB, key), devices / 3600.0, "h"))
    queries = [
        own + other
        for own, other in zip(_slopes(rows, STUB, "query_cpu_s"), _slopes(rows, STUB, "query_workers_cpu_s"))
    ]
    found.append(_range("a query over all rows, processor time", queries, float(devices), "s"))
    found.append(_range("memory of the driver", _lines(rows, "peak_mb", devices), 1e-3, "GB"))
    found.append(_range("memory of the report", _lines(rows, "report_peak_mb", devices), 1e-3, "GB"))
    return [cost for cost in found if cost is not None]


def _range(name: str, values: Sequence[float], factor: float, unit: str) -> Cost | None:
    if not values:
        return None
    return Cost(name, factor * min(values), factor * max(values), unit)


def _largest(rows: Sequence[Row], kind: str) -> list[tuple[Row, Row]]:
    """The two largest runs of a kind, for each number of workers that has both."""
    own = {(float(row["value"]), int(row["workers"])): row for row in rows if row["kind"] == kind}
    values = sorted({value for value, _ in own})[-2:]
    if len(values) < 2:
        return []
    small, large = values
    return [
        (own[small, workers], own[large, workers])
        for workers in VALUES[kind][1]
        if (small, workers) in own and (large, workers) in own
    ]


def _slopes(rows: Sequence[Row], kind: str, key: str) -> list[float]:
    """Growth of a figure per device between the two largest runs, for each number of workers."""
    return [(b[key] - a[key]) / (b["devices"] - a["devices"]) for a, b in _largest(rows, kind)]


def _lines(rows: Sequence[Row], key: str, devices: int) -> list[float]:
    """A figure of stub runs extrapolated to ``devices``, for each number of workers."""
    return [
        b[key] + (b[key] - a[key]) / (b["devices"] - a["devices"]) * (devices - b["devices"])
        for a, b in _largest(rows, STUB)
    ]


def _of_draws(rows: Sequence[Row], key: str) -> list[float]:
    """What the stored draws of a device add to a figure."""
    return [(b[key] - a[key]) / b["devices"] for a, b in _largest(rows, DRAWS)]


def tables_of(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    lines = ["| " + " | ".join(_COLUMNS) + " |", "|" + "---|" * len(_COLUMNS)]
    lines += ["| " + " | ".join(text(row) for text in _COLUMNS.values()) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def cost_table(costs: Sequence[Cost], devices: int) -> str:
    """The figures of a night as a Markdown table."""
    lines = [f"| {devices:,} devices | least | largest | |", "|---|---|---|---|"]
    lines += [f"| {cost.name} | {cost.low:.3g} | {cost.high:.3g} | {cost.unit} |" for cost in costs]
    return "\n".join(lines) + "\n"
