"""Results of pytest-benchmark as rows, and the table of docs/reference/parts.md.

All times are least processor times of one run.  A ratio is a part's time per device over that of the reference loop in the round
before, median over the rounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: The part that contains the others; parts inside another one do not count twice.
_WHOLE = "device"


@dataclass(frozen=True)
class Peer:
    """A peer of a part: time of the whole task [s]."""

    name: str
    seconds: float
    note: str


@dataclass(frozen=True)
class Part:
    """A part of a device: time per device [s], ratio to the reference loop, limit [s] with its formula, and its peers."""

    name: str
    seconds: float
    ratio: float
    limit_s: float
    formula: str
    inside: str
    peers: tuple[Peer, ...]


@dataclass(frozen=True)
class Results:
    """The parts of one run, and the least time [s] of one unit of each primitive."""

    parts: tuple[Part, ...]
    units: Mapping[str, float]


def results_of(benchmarks: Sequence[Mapping[str, Any]]) -> Results:
    """The results of the entry "benchmarks" of pytest-benchmark's JSON.

    Raises
    ------
    ValueError : a limit names a primitive that was not measured.
    """
    entries = [(one["extra_info"], float(one["stats"]["min"])) for one in benchmarks]
    units = {info["name"]: least / info["count"] for info, least in entries if info["role"] == "primitive"}
    peers = [
        (info["of"], Peer(info["name"], least * info["times"], info["note"]))
        for info, least in entries
        if info["role"] == "peer"
    ]
    parts = []
    for info, least in entries:
        if info["role"] != "part":
            continue
        unknown = set(info["limit"]) - set(units)
        if unknown:
            raise ValueError(f"the limit of {info['name']} names primitives that were not measured: {sorted(unknown)}")
        seconds = least / info["devices"]
        limit = sum(count * units[name] for name, count in info["limit"].items())
        own = tuple(peer for name, peer in peers if name == info["name"])
        ratio = info["ratio"] / info["devices"]
        parts.append(Part(info["name"], seconds, ratio, limit, info["formula"], info["inside"], own))
    return Results(tuple(_summed(parts)), units)


def _summed(parts: Sequence[Part]) -> list[Part]:
    """The parts with the limit of the whole device, which is the sum of those of its parts."""
    limit = sum(part.limit_s for part in parts if part.inside == _WHOLE)
    return [
        Part(p.name, p.seconds, p.ratio, limit, p.formula, p.inside, p.peers) if p.name == _WHOLE else p for p in parts
    ]


def rest_of(results: Results) -> float | None:
    """Time of the device that no part accounts for [s]; ``None`` if the device was not timed."""
    whole = next((part.seconds for part in results.parts if part.name == _WHOLE), None)
    return None if whole is None else whole - sum(part.seconds for part in results.parts if part.inside == _WHOLE)


def table_of(results: Results) -> str:
    """The parts with their limits, then the peers, as Markdown."""
    lines = [
        "| part | ms a device | reference loops | limit, ms | time over limit | the limit |",
        "|---|---|---|---|---|---|",
    ]
    for part in results.parts:
        inside = f", in {part.inside}" if part.inside not in ("", _WHOLE) else ""
        over = f"{part.seconds / part.limit_s:.1f}" if part.limit_s else "-"
        lines.append(
            f"| {part.name}{inside} | {1e3 * part.seconds:.3g} | {part.ratio:.3g} | {1e3 * part.limit_s:.3g} | {over}"
            f" | {part.formula} |"
        )
    rest = rest_of(results)
    if rest is not None:
        lines.append(f"| rest of the device: draw, columns, tables | {1e3 * rest:.3g} | | | | |")
    lines += ["", "| part | peer | peer, ms | peer over part | note |", "|---|---|---|---|---|"]
    for part in results.parts:
        for peer in part.peers:
            times = peer.seconds / part.seconds
            lines.append(f"| {part.name} | {peer.name} | {1e3 * peer.seconds:.3g} | {times:.3g} | {peer.note} |")
    lines += ["", "| primitive | least time of a unit, ns |", "|---|---|"]
    lines += [f"| {name} | {1e9 * unit:.3g} |" for name, unit in results.units.items()]
    return "\n".join(lines) + "\n"
