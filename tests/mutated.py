"""Mutated inputs of the command line: measurement files, configurations, TOML shapes.  A case follows from its random stream."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from pipeline.experiment.files.readers import WRITTEN, write_columns

ROOT = Path(__file__).parents[1]
SAMPLES, RATE_HZ = 1500, 2000.0
NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-1", "1e13", "99999999999999999999", "0x10", "")
TEXTS = ("", "true", "'x'", "[]", "{}", "[1]", "[[1]]", "{ a = 1 }", "1979-05-27T07:32:00Z", "nan", "-inf", "-1", "0", "1e308",
         "9223372036854775808", "'\\u0000'", "'../../..'", "'" + "x" * 5000 + "'", "[" * 20, '"\\ud800"', "'''")  # fmt: skip
KEYS = {
    "campaign": ["device", "device.id", "device.angular_gain", "demodulation.phase_error_deg", "demodulation.drive", "instrument",
                 "instrument.sample_rate_hz", "instrument.hold", "instrument.bias_v", "instrument.antialias", "instrument.adc",
                 "instrument.adc.bits", "record", "record.file", "record.role", "record.start", "record.stop", "record.rate_dps",
                 "record.temperature_c", "reference", "reference.f1_hz", "columns", "columns.drive1_V", "channels.lag_samples",
                 "channels.sense_order", "channels.drive_offset_v", "systematic.clock_sd_ppm", "kind"],
    "run": ["run", "run.devices", "run.seed", "run.block", "run.workers", "run.device_limit_s", "source", "source.kind",
            "source.spec", "source.path", "source.values", "source.spec_toml", "instrument.adc.full_scale_v", "noise",
            "noise.kind", "noise.snr_db", "experiment", "experiment.effects", "limits", "limits.split_hz", "rule", "gate",
            "posterior", "posterior.walkers", "diagnosis", "diagnosis.enabled", "trim", "effects", "effect_folders"],
    "model": ["plant", "plant.kind", "plant.modes", "effects", "fixed", "fixed.theta_deg", "prior", "prior.theta_deg",
              "effect_folders"],
}  # fmt: skip


@lru_cache
def base() -> dict[str, np.ndarray]:
    """The columns of a sound record with one drive and one sense."""
    t = np.arange(SAMPLES) / RATE_HZ
    u = np.sin(2 * np.pi * (50.0 * t + 200.0 * t**2))
    y = 0.1 * np.convolve(u, np.exp(-np.arange(200) / 40.0) * np.sin(np.arange(200)), "full")[:SAMPLES]
    y += 1e-3 * np.random.default_rng(1).standard_normal(SAMPLES)
    return {"time_s": t, "drive1_V": u, "sense1_V": y}


def _columns(r: random.Random) -> dict[str, np.ndarray]:
    """The columns with a fault in their values."""
    c = {name: values.copy() for name, values in base().items()}
    name, at = r.choice(list(c)), r.randrange(SAMPLES)
    kind = r.randrange(12)
    if kind == 0:
        a, b = r.sample(list(c), 2)
        c[a], c[b] = c[b], c[a]
    elif kind == 1:
        c[name][at : at + r.choice((1, 50, SAMPLES))] = float(
            r.choice(("nan", "inf", "-inf", "1e308", "1e13", "1e-320", "0"))
        )
    elif kind == 2:
        c["time_s"] = r.choice(
            (c["time_s"][::-1], np.zeros(SAMPLES), np.sort(np.random.default_rng(at).random(SAMPLES)))
        )
    elif kind == 3:
        c["time_s"][at:] += r.choice((1e-3, -1e-2, 1e6, 5e-4, 1e-9))
    elif kind == 4:
        c = {k: v[: r.choice((0, 1, 15, 16, 17, 40, 100))] for k, v in c.items()}
    elif kind == 5:
        c[name] = r.choice(
            (c[name].astype("f4"), (c[name] * 100).astype("i2"), c[name] > 0, np.round(c[name], r.randrange(4)))
        )
    elif kind == 6:
        del c[name]
    elif kind == 7:
        c[r.choice(("drive2_V", "sense3_V", "Sense1_V", "sense0_V", "time", "x" * 300, "sense1_V "))] = c.pop(name)
    elif kind == 8:
        c[name] = c[name] * 10.0 ** r.uniform(-300, 300)
    elif kind == 9:
        c |= {f"sense{k + 2}_V": c["sense1_V"] + k for k in range(r.choice((1, 3, 30)))}
    elif kind == 10:
        c[name] = c[name][: r.randrange(SAMPLES)]
    else:
        c[name][::2] = c[name][0]
    return c


def _bytes(r: random.Random, data: bytes) -> bytes:
    """The content of a file with a fault in its bytes."""
    out, kind = bytearray(data), r.randrange(6)
    if kind == 0:
        return bytes(out[: r.randrange(len(out))])
    if kind == 1:
        for _ in range(r.choice((1, 3, 30, 300))):
            out[r.randrange(len(out))] ^= 1 << r.randrange(8)
    elif kind == 2:
        at = r.randrange(len(out))
        del out[at : at + r.randrange(1, 200)]
    elif kind == 3:
        at = r.randrange(len(out))
        out[at:at] = out[: r.randrange(1, 500)]
    elif kind == 4:
        at = r.randrange(max(len(out) - 64, 1))
        out[at : at + r.randrange(1, 64)] = bytes(r.choice((0, 255)) for _ in range(r.randrange(1, 64)))
    else:
        return b"" if r.random() < 0.1 else bytes(out) + r.randbytes(r.randrange(1, 1000))
    return bytes(out)


def _text(r: random.Random, text: str) -> bytes:
    """A text table with another delimiter, encoding, header or cell."""
    rows, kind = text.splitlines(), r.randrange(8)
    if kind == 0:
        return text.replace(",", r.choice((";", "\t", " ", "|", ":", ""))).encode()
    if kind == 1:
        return text.encode(r.choice(("utf-16", "utf-32", "utf-8-sig", "utf-7", "cp037")))
    if kind == 2:
        rows[0] = r.choice(
            ("a,b,c", "time_s,time_s,time_s", "", ",,", "time_s,drive1_V,sense1_V," * 300, "\xff\xfe,b,c", '"')
        )
    elif kind == 3:
        at = r.randrange(1, len(rows))
        rows[at] = r.choice(NUMBERS) + "," + rows[at].partition(",")[2]
    elif kind == 4:
        rows[r.randrange(1, len(rows))] += r.choice((",1", ',"', '"', "\0", ",,,,", "\r", "# x"))
    elif kind == 5:
        rows = rows[1:] if r.random() < 0.5 else rows[:1] * 3 + rows
    elif kind == 6:
        return text.replace(".", ",").encode() if r.random() < 0.5 else "\n".join(reversed(rows)).encode()
    else:
        rows[r.randrange(len(rows))] = "é" * r.choice((1, 100, 100_000))
        return "\n".join(rows).encode(r.choice(("latin-1", "utf-8")))
    return "\n".join(rows).encode("utf-8", "surrogateescape")


def file_case(r: random.Random, folder: Path) -> tuple[str, list[str]]:
    """`check` of a mutated record file."""
    form = r.choice([one for one in WRITTEN if one != "tdms"])
    how = r.choice(("values", "bytes", "text") if form == "csv" else ("values", "bytes"))
    try:
        path = write_columns(folder, "record", _columns(r) if how == "values" else dict(base()), form)
    except Exception:  # the library that writes refuses these columns
        path = write_columns(folder, "record", dict(base()), form)
    if how != "values":
        data = path.read_bytes()
        path.write_bytes(_bytes(r, data) if how == "bytes" else _text(r, data.decode()))
    return f"{form} {how}", ["check", str(path)]


def _mutated_toml(r: random.Random, text: str, keys: list[str]) -> str:
    lines = text.splitlines() or [""]
    for _ in range(r.choice((1, 1, 2, 4))):
        at, kind = r.randrange(len(lines)), r.randrange(6)
        if kind == 0 and "=" in lines[at]:
            lines[at] = lines[at].split("=")[0] + "= " + r.choice(TEXTS + NUMBERS)
        elif kind == 1:
            lines.insert(at, f"{r.choice(keys)} = {r.choice(TEXTS + NUMBERS)}")
        elif kind == 2:
            lines.insert(at, r.choice(("[{}]", "[[{}]]")).format(r.choice(keys)))
        elif kind == 3:
            lines[at] = _bytes(r, lines[at].encode() or b"x").decode(errors="replace")
        elif kind == 4:
            lines.append(lines[at])
        else:
            del lines[at]
            lines = lines or [""]
    return "\n".join(lines)


CAMPAIGN = """[device]\nid = "A"\nangular_gain = 0.7\n[demodulation]\nphase_error_deg = 1.0\n[instrument]\nsample_rate_hz = 2000.0
hold = "zoh"\nbias_v = 5.0\nadc = { bits = 16, full_scale_v = 10.0 }\n[[record]]\nfile = "record.npz"
role = "fit"\nrate_dps = 0.0
[reference]\nf1_hz = [534.6, 0.1]\n[columns]\ndrive1_V = "drive1_V"\n"""
RUN = """[run]\ndevices = 4\nseed = 3\nblock = 2\n[source]\nkind = "population"\nspec = "pop.toml"\n[diagnosis]\nenabled = false
[instrument]\nsample_rate_hz = 10000.0\n"""
MODEL = """plant = "gyro"\neffects = ["offdiagonal_damping"]\n[fixed]\nsense_imbalance = 0.0\n"""


def config_case(r: random.Random, folder: Path) -> tuple[str, list[str]]:
    """A mutated campaign, run, population or model file, and the command that reads it."""
    kind = r.choice(("campaign", "run", "population", "model"))
    write_columns(folder, "record", dict(base()), "npz")
    spec = (ROOT / "populations/specs/cloverleaf.toml").read_text()
    texts = {"campaign": CAMPAIGN, "run": RUN, "population": spec, "model": MODEL}
    own = [line.split("=")[0].strip() for line in spec.splitlines() if "=" in line and line[0] != "#"]
    keys = {**KEYS, "population": own}[kind]
    files = {"campaign": "campaign.toml", "run": "run.toml", "population": "pop.toml", "model": "model.toml"}
    for name, file in files.items():
        text = _mutated_toml(r, texts[name], keys) if name == kind else texts[name]
        (folder / file).write_text(text, encoding="utf-8", errors="replace")
    run = ["run", str(folder / "run.toml"), "--dry-run", "--out", str(folder / "results")]
    commands = {
        "campaign": ["check", str(folder / "campaign.toml")],
        "run": run,
        "population": run,
        "model": ["model", "show", str(folder / "model.toml")],
    }
    return kind, commands[kind]


def shape_case(r: random.Random, folder: Path) -> tuple[str, list[str]]:
    """A TOML file of an unusual shape, as campaign, run or model file."""
    kind = r.choice(("campaign", "run", "model"))
    n, key, value = r.choice((1, 8, 17, 500, 100_000)), r.choice(KEYS[kind]), r.choice(TEXTS)
    shape = r.choice((
        "x = " + "[" * n, "x = " + "[" * n + "]" * n, "x = " + "{ a = " * n, "a." * n + "a = 1", "k" * n + " = 1",
        f'"{"q" * n}" = 1', f"[[{key}]]\n" * n, f"[{key}]\n[[{key}]]", f"{key} = {value}", f"[{key}]\nx = {value}",
        f"[[{key}]]\n{key} = {value}", f"{key} = [{value}, {value}]", f"{key} = {{ {key} = 1 }}", "[" * n, "#" * n,
        '"""' + "\\" * n,
        "x = [" + "[]," * min(n, 300_000) + "]", "\ufeffx = 1", "x = 1\r\r", "[a]\n" * n, f"[{'.'.join(['a'] * min(n, 900))}]",
    ))  # fmt: skip
    files = {"campaign": "campaign.toml", "run": "run.toml", "model": "model.toml"}
    path = folder / files[kind]
    path.write_text(shape, encoding="utf-8")
    command = {"campaign": ["check"], "run": ["run"], "model": ["model", "show"]}[kind]
    return f"{kind} {shape[:12]}", [*command, str(path), *(["--dry-run"] if kind == "run" else [])]


CASES: dict[str, Callable[[random.Random, Path], tuple[str, list[str]]]] = {
    "files": file_case,
    "configs": config_case,
    "shapes": shape_case,
}
