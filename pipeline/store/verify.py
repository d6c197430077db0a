"""Verify that stored results are exactly what was committed.

A finding is fatal when committed results are damaged, missing or contradictory; a stray file is reported,
but readers ignore it because they take their files from the manifest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from ..errors import IntegrityError, UsageError
from .checkpoint import OWN
from .digest import TableDigest, comparable
from .files import STAGED, sha256
from .folders import PREFIX, run_folders
from .irregularity_table import schema_of
from .journal import journal_name, read_manifest
from .lock import NAME as LOCK
from .log import NAME as LOG
from .log import damages
from .manifest import NAME as MANIFEST
from .manifest import FileEntry, Manifest, in_block_order
from .parquet import decode_table
from .read import read_file
from .stream import Names, tables

#: Folder in that of a run where damaged files go when they are repaired.
ASIDE = "damaged"


@dataclass(frozen=True)
class IntegrityFinding:
    """One deviation; ``fatal`` if it affects results."""

    file: str
    what: str
    expected: str
    found: str
    fatal: bool = True

    def __str__(self) -> str:
        severity = "damage" if self.fatal else "note"
        return f"{severity}: {self.file}: {self.what}; expected {self.expected}, found {self.found}"


@dataclass(frozen=True)
class VerifyReport:
    """All findings, and the number of runs, files and rows checked."""

    findings: tuple[IntegrityFinding, ...]
    runs: int
    files: int
    bytes: int
    devices: int
    draws: int

    @property
    def errors(self) -> tuple[IntegrityFinding, ...]:
        """The fatal findings."""
        return tuple(finding for finding in self.findings if finding.fatal)

    @property
    def ok(self) -> bool:
        """No fatal finding."""
        return not self.errors

    def to_dict(self) -> dict[str, Any]:
        """The report for JSON."""
        return {"ok": self.ok, **asdict(self)}

    def require(self) -> None:
        """Raise IntegrityError, naming the first fatal findings, unless ``ok``."""
        if self.errors:
            raise IntegrityError(
                f"{len(self.errors)} of the stored results' checks failed",
                value="; ".join(str(finding) for finding in self.errors[:3]),
                allowed="results as they were committed",
                next_step="restore the named files from a copy, or move the run away and run it again",
            )

    def __str__(self) -> str:
        checked = (
            f"{self.runs} runs, {self.files} files, {self.bytes / 1e6:.1f} MB, "
            f"{self.devices} devices, {self.draws} draws"
        )
        verdict = "sound" if self.ok else f"{len(self.errors)} damaged"
        return "\n".join([*(str(finding) for finding in self.findings), f"{checked}: {verdict}"])


def verify(results: Path) -> VerifyReport:
    """Check all runs of a results folder, and name every file that no manifest lists.

    Checked are the manifest against its own SHA-256, every listed file against the manifest, every Parquet page against
    its checksum, schema, row counts, blocks without gaps, devices without duplicates, and the digest of a finished run.

    Raises
    ------
    UsageError : there is no such folder, or no run in it.
    """
    if not results.is_dir():
        raise UsageError("there is no such results folder", value=str(results), next_step="name it with --results")
    folders = run_folders(results)
    findings = list(_strays(results, {folder.name for folder in folders}))
    if not folders and not findings:
        raise UsageError(
            "the results folder holds no runs",
            value=str(results),
            next_step="make one with `gyroscreen run`, or name the folder with --results",
        )
    checked = [verify_run(folder) for folder in folders]
    return VerifyReport(
        findings=tuple(findings + [finding for report in checked for finding in report.findings]),
        runs=len(folders),
        files=sum(report.files for report in checked),
        bytes=sum(report.bytes for report in checked),
        devices=sum(report.devices for report in checked),
        draws=sum(report.draws for report in checked),
    )


def verify_run(folder: Path) -> VerifyReport:
    """Check one run; see :func:`verify`."""
    try:
        manifest = read_manifest(folder)
    except IntegrityError as error:
        journal = next((path for path in folder.glob("journal-*.jsonl") if str(path) in error.what), None)
        finding = _damage(journal or folder / MANIFEST, error)
        return VerifyReport((finding,), runs=1, files=0, bytes=0, devices=0, draws=0)
    findings = list(_strays(folder, {entry.name for entry in manifest.files} | {MANIFEST, LOG, LOCK, _journal(folder)}))
    findings += _structure(folder, manifest)
    findings += [
        IntegrityFinding(str(folder / LOG), what, "what was written", "damage")
        for what in damages(folder, manifest.log)
    ]
    digest, names = TableDigest(), Names()
    devices = draws = 0
    for entry in in_block_order(manifest.files):
        try:
            table = _verify_file(folder, entry)
        except IntegrityError as error:
            findings.append(_damage(folder / entry.name, error))
            continue
        if table is not None and table.num_rows != entry.rows:
            findings.append(
                IntegrityFinding(str(folder / entry.name), "number of rows", str(entry.rows), str(table.num_rows))
            )
        if table is not None and entry.kind == "devices":
            digest.add(table)
            names.add(table)
            devices += table.num_rows
        elif table is not None and entry.kind == "posterior":
            draws += table.num_rows
    if not any(finding.fatal for finding in findings):
        findings += _contents(folder, manifest, digest.result(), names)
    return VerifyReport(
        tuple(findings),
        runs=1,
        files=len(manifest.files),
        bytes=sum(entry.bytes for entry in manifest.files),
        devices=devices,
        draws=draws,
    )


def _journal(folder: Path) -> str:
    """Name of the journal that belongs to the manifest; another one is the rest of an interrupted checkpoint."""
    return journal_name(sha256((folder / MANIFEST).read_bytes()))


def _verify_file(folder: Path, entry: FileEntry) -> pa.Table | None:
    """The table of a file that holds one; raise IntegrityError if it differs from what was committed."""
    data = read_file(folder, entry)
    if entry.kind in ("config", "page"):
        return None
    return decode_table(data, schema_of(entry.kind), str(folder / entry.name))


def _structure(folder: Path, manifest: Manifest) -> Iterator[IntegrityFinding]:
    """Contradictions within the manifest."""
    where = str(folder / MANIFEST)
    for name, times in Counter(entry.name for entry in manifest.files).items():
        if times > 1:
            yield IntegrityFinding(where, f"{name} is listed more than once", "1", str(times))
    config = [entry.sha256 for entry in manifest.of_kind("config")]
    if config != [manifest.config_sha256]:
        yield IntegrityFinding(
            where, "run.toml is not listed with the hash of the configuration", "1 entry", str(config)
        )
    blocks = manifest.blocks()
    times = sum(len(entry.span()) for entry in manifest.of_kind("devices"))
    if times != len(blocks):
        yield IntegrityFinding(where, "blocks in more than one file", f"{len(blocks)} blocks", f"{times} blocks")
    missing = sorted(set(range(max(blocks, default=-1) + 1)) - blocks)
    if missing:
        fatal = manifest.status == "complete"
        yield IntegrityFinding(where, f"blocks of a {manifest.status} run", "no gaps", f"missing {missing[:10]}", fatal)
    for kind, what in (("posterior", "draws"), ("irregularities", "irregularities")):
        orphans = [entry.block for entry in manifest.files if entry.kind == kind and entry.block not in blocks]
        if orphans:
            yield IntegrityFinding(
                where, f"{what} without their devices", "a devices table each", f"blocks {orphans[:10]}"
            )


def _contents(folder: Path, manifest: Manifest, digest: str, names: Names) -> Iterator[IntegrityFinding]:
    """Contradictions between the manifest and the complete table."""
    twice = names.twice(lambda: tables(folder, manifest, "devices"))
    if twice:
        yield IntegrityFinding(str(folder), "devices with more than one row", "one row a device", ", ".join(twice[:5]))
    # Digests of earlier versions are defined otherwise; the SHA-256 of every file has been checked in any case.
    stored = manifest.devices_digest
    if stored is not None and comparable(stored) and stored != digest:
        yield IntegrityFinding(str(folder), "digest of the devices table", stored, digest)


def _strays(folder: Path, known: set[str]) -> Iterator[IntegrityFinding]:
    for path in sorted(folder.iterdir()):
        if path.name in known:
            continue
        if path.name.endswith(STAGED) or OWN.fullmatch(path.name):
            what = "left by an interrupted write or added by hand; not part of any result"
        elif path.name == ASIDE:
            what = "damaged files that --repair has put aside; not part of any result"
        elif path.name.startswith(PREFIX):
            what = "a run's folder without a manifest; not part of any result"
        else:
            what = "stray file, not part of any result"
        yield IntegrityFinding(str(path), what, "only what the manifests list", path.name, fatal=False)


def _damage(path: Path, error: IntegrityError) -> IntegrityFinding:
    return IntegrityFinding(str(path), error.what, error.allowed or "what was committed", str(error.value or "damage"))
