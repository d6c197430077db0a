"""More mutated inputs: TDMS, LVM, text without a header, nested MAT and HDF5, limits; and `init` on all of them."""

from __future__ import annotations

import io
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import savemat

from pipeline.experiment.files.readers import write_columns
from tests.mutated import NUMBERS, ROOT, _bytes, _columns, _mutated_toml, _text, base

LIMITS = (ROOT / "reports/limits_default.toml").read_text(encoding="utf-8")
NAMED = '[instrument]\nsample_rate_hz = 2000.0\n[[record]]\nfile = "{file}"\n[columns]\ndrive1_V = {drive}\nsense1_V = {sense}\n'
LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
Multi_Headings\tNo
X_Columns\t{columns}
***End_of_Header***\t
Channels\t2
Samples\t1500\t1500
Y_Unit_Label\tVolts\tVolts
Delta_X\t0.0005\t0.0005
X0\t0\t0
***End_of_Header***\t
X_Value\tdrive1_V\tsense1_V\tComment
"""


def _campaign(folder: Path, file: str, drive: str, sense: str) -> list[str]:
    (folder / "campaign.toml").write_text(NAMED.format(file=file, drive=drive, sense=sense))
    return ["check", str(folder / "campaign.toml")]


def _rows(r: random.Random, columns: dict[str, np.ndarray], mark: str, decimal: str = ".") -> str:
    size = min(values.size for values in columns.values())
    table = np.stack([values[:size].astype(float) for values in columns.values()], axis=1)
    out = io.StringIO()
    np.savetxt(out, table, delimiter=mark, fmt=r.choice(("%.9g", "%.3f", "%d", "%.17e")))
    return out.getvalue().replace(".", decimal)


def _tdms(r: random.Random, folder: Path) -> tuple[Path, list[str]]:
    try:
        path = write_columns(folder, "record", _columns(r) if r.random() < 0.4 else dict(base()), "tdms")
    except Exception:  # the library that writes refuses these columns
        path = write_columns(folder, "record", dict(base()), "tdms")
    if r.random() < 0.7:
        path.write_bytes(_bytes(r, path.read_bytes()))
    return path, ["check", str(path)]


def _lvm(r: random.Random, folder: Path) -> tuple[Path, list[str]]:
    path = folder / "record.lvm"
    head = LVM.format(columns=r.choice(("One", "Multi", "No", "", "1")))
    if r.random() < 0.5:
        lines = head.splitlines()
        at = r.randrange(len(lines))
        lines[at] = r.choice(
            (lines[at].split("\t")[0] + "\t" + r.choice(NUMBERS), "", lines[at] * 3, "x\ty", "***End_of_Header***")
        )
        head = "\n".join(lines) + "\n"
    text = head + _rows(r, dict(base()), "\t", r.choice((".", ".", ",")))
    how = r.randrange(3)
    path.write_bytes(_text(r, text) if how == 0 else _bytes(r, text.encode()) if how == 1 else text.encode())
    return path, _campaign(folder, "record.lvm", '"drive1_V"', '"sense1_V"')


def _headless(r: random.Random, folder: Path) -> tuple[Path, list[str]]:
    path = folder / r.choice(("record.dat", "record.txt", "record.asc", "record.tsv", "record.csv"))
    mark, decimal = r.choice(("\t", " ", ",", ";", "  ", "|")), r.choice((".", ".", ","))
    head = r.choice(("", "", "# a comment\n", "file made by hand\nRate: 2000 Hz\n\n", "%\n" * 2000, '"', "\0" * 100))
    text = head + _rows(r, dict(base()), mark, decimal)
    how = r.randrange(3)
    path.write_bytes(_text(r, text) if how == 0 else _bytes(r, text.encode()) if how == 1 else text.encode())
    return path, _campaign(folder, path.name, r.choice(("2", "1", "0", "9", "{ number = 2 }")), "3")


def _nested(r: random.Random) -> dict[str, Any]:
    """Vectors inside structures, among things that are no vectors."""
    inner: dict[str, Any] = {name.replace("_V", ""): values for name, values in _columns(r).items() if len(name) < 30}
    others: list[Any] = [
        "text", "", 3, 1j * np.ones(5), np.ones((2, 3, 4)), np.zeros(0), np.array([["a", 1.0]], dtype=object),
        np.ones((1500, 70)), {"x": {"y": {"z": np.arange(1500.0)}}}, True, np.array(["a", "b"]), np.float32(2.0),
    ]  # fmt: skip
    for k in range(r.randrange(4)):
        inner[f"other{k}"] = r.choice(others)
    for _ in range(r.choice((0, 1, 2, 20))):
        inner = {"level": inner}
    return {"data": inner, "note": r.choice(others)}


def _mat(r: random.Random, folder: Path) -> tuple[Path, list[str]]:
    path = folder / "record.mat"
    try:
        savemat(path, _nested(r), do_compression=r.random() < 0.5, long_field_names=True)
    except Exception:  # the library that writes refuses this
        savemat(
            path, {"data": {"time_s": base()["time_s"], "drive1": base()["drive1_V"], "sense1": base()["sense1_V"]}}
        )
    if r.random() < 0.5:
        path.write_bytes(_bytes(r, path.read_bytes()))
    return path, _campaign(folder, "record.mat", '"drive1"', '"sense1"')


def _fill(group: h5py.Group, content: dict[str, Any]) -> None:
    for name, value in content.items():
        if isinstance(value, dict):
            _fill(group.create_group(name), value)
        else:
            group.create_dataset(name, data=value)


def _hdf5(r: random.Random, folder: Path) -> tuple[Path, list[str]]:
    path = folder / "record.h5"
    path.unlink(missing_ok=True)
    with h5py.File(path, "w") as file:
        try:
            _fill(file, _nested(r))
        except Exception:  # the library that writes refuses this
            _fill(file, {"more": {"drive1": base()["drive1_V"], "sense1": base()["sense1_V"]}})
        kind = r.randrange(7)
        if kind == 0:
            file["loop"] = h5py.SoftLink("/loop")
        elif kind == 1:
            file["round"] = file["/"]  # a hard link to the root
        elif kind == 2:
            file["elsewhere"] = h5py.ExternalLink(r.choice(("none.h5", "record.h5", "/etc/passwd")), "/data")
        elif kind == 3:
            file.create_dataset("huge", shape=(2**40,), chunks=(2**16,), dtype="f8", compression="gzip")
        elif kind == 4:
            file.create_dataset("pairs", data=np.zeros(1500, dtype=[("a", "f8"), ("b", "i4")]))
            file["pairs"].attrs["unit"] = r.choice(("V", "", b"\xff", np.zeros(3)))
    if r.random() < 0.5:
        path.write_bytes(_bytes(r, path.read_bytes()))
    return path, _campaign(folder, "record.h5", '"drive1"', '"sense1"')


FILES: dict[str, Callable[[random.Random, Path], tuple[Path, list[str]]]] = {
    "tdms": _tdms,
    "lvm": _lvm,
    "text without header": _headless,
    "nested mat": _mat,
    "nested hdf5": _hdf5,
}


def files2_case(r: random.Random, folder: Path) -> tuple[str, list[str]]:
    """`check` of a mutated record of these formats, or `identify` with mutated limits (of a record that is missing)."""
    kind = r.choice([*FILES, "limits"])
    if kind == "limits":
        path = folder / "limits.toml"
        keys = ["limits.split_hz", "split_hz.min", "theta_deg", "rule", "rule.pass_at", "rule.name", "limits", "x" * 40]
        path.write_text(_mutated_toml(r, LIMITS, keys), encoding="utf-8", errors="replace")
        return kind, ["identify", str(folder / "missing.npz"), "--limits", str(path)]
    return kind, FILES[kind](r, folder)[1]


def init_case(r: random.Random, folder: Path) -> tuple[str, list[str]]:
    """`init` of one or two mutated files."""
    kind = r.choice(["csv", *FILES])
    if kind == "csv":
        path = write_columns(folder, "plain", dict(base()), "csv")
        path.write_bytes(_text(r, path.read_text()) if r.random() < 0.5 else _bytes(r, path.read_bytes()))
    else:
        path, _ = FILES[kind](r, folder)
    more = [str(path)] if r.random() < 0.1 else []
    out = folder / "made"
    shutil.rmtree(out, ignore_errors=True)
    return f"init {kind}", ["init", str(path), *more, "--out", str(out)]
