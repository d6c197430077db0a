"""Records of a device that shares no code with the project, into which tests plant faults.

The plant is the paper's, as a state space with its filters, discretised by scipy.
"""

import dataclasses
import functools

import msgspec
import numpy as np
from scipy import signal

from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.checks.check import CheckReport, check
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Record
from pipeline.toml_files import table as toml_table

FS = 10_000.0
MS = np.array([[-1.0, -1.0], [1.0, -1.0]])
MD = np.array([[-1.0, 1.0], [1.0, 1.0]])


def paper_device(theta_deg, split_hz=1.9, filtered=True):
    """State space in units of one sample: time in samples, so that its matrices are well scaled."""
    c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    rotation = np.array([[c, -s], [s, c]])
    gains_s, gains_d = np.diag([0.964, 1.036]), np.diag([0.999, 1.001])
    B = np.vstack([13.3 * rotation.T @ MD @ gains_d, 28.5 * np.ones((1, 2)) @ gains_d]) / FS
    C = np.hstack([gains_s @ MS @ rotation, gains_s @ np.ones((2, 1))])
    w = 2.0 * np.pi * np.array([534.5, 534.5 + split_hz, 590.3]) / FS
    zeta = np.array([3.167e-4, 1.586e-4, 1.17e-3])
    A = np.zeros((6, 6))
    A[0::2, 1::2], A[1::2, 0::2], A[1::2, 1::2] = np.eye(3), np.diag(-(w**2)), np.diag(-2.0 * zeta * w)
    inputs, outputs = np.zeros((6, 2)), np.zeros((2, 6))
    inputs[1::2], outputs[:, 1::2] = B, C
    if not filtered:
        return A, inputs, outputs
    Af, Bf, Cf, _ = signal.zpk2ss(*signal.butter(8, 2.0 * np.pi * 0.48, analog=True, output="zpk"))
    Af, Bf, Cf = np.kron(np.eye(2), Af), np.kron(np.eye(2), Bf), np.kron(np.eye(2), Cf)
    whole = np.block([[A, np.zeros((6, 16))], [Bf @ outputs, Af]])
    return whole, np.vstack([inputs, np.zeros((16, 2))]), np.hstack([np.zeros((2, 6)), Cf])


def sensed(drive, theta_deg=-33.0, hold="zoh", start=None, **device):
    """Exact response (N, 2) of the paper's device; ``start`` is the state at the first sample."""
    A, B, C = paper_device(theta_deg, **device)
    A, B, C, D, _ = signal.cont2discrete((A, B, C, np.zeros((2, 2))), 1.0, hold)
    z, V = np.linalg.eig(A)
    Bm, Cm = np.linalg.solve(V, B), C @ V
    first = np.zeros(z.size) if start is None else np.linalg.solve(V, np.resize([*start, *[0] * 22], z.size))
    y = drive @ D.T + 0j
    for k in range(z.size):
        x = signal.lfilter([0.0, 1.0], [1.0, -z[k]], drive @ Bm[k])
        y += (x + first[k] * z[k] ** np.arange(len(drive)))[:, None] * Cm[:, k]
    return y.real


def chirps(samples=30_000, swapped=False, amplitude=2.0):
    t = np.arange(samples) / FS
    up = amplitude * signal.chirp(t, 400.0, samples / FS, 700.0)
    down = amplitude * signal.chirp(t, 700.0, samples / FS, 400.0)
    return np.stack([down, up] if swapped else [up, down], axis=1)


def noise(samples, seed, sigma=1e-3):
    return sigma * np.random.default_rng(seed).standard_normal((samples, 2))


def campaign_of(*pairs, instrument=None, roles=("noise", "fit", "validate")):
    records = tuple(
        Record(f"record-{k + 1}.parquet", FS, drive, sense, role=role)
        for k, ((drive, sense), role) in enumerate(zip(pairs, roles, strict=True))
    )
    return Campaign("A17", records, instrument or Instrument(antialias=AntiAlias()))


@functools.cache
def healthy(seed=0, **device):
    """Silence, the paper's chirp, the chirp with its directions swapped."""
    silent = np.zeros((10_000, 2))
    one, two = chirps(), chirps(swapped=True)
    return campaign_of(
        (silent, noise(10_000, seed)),
        (one, sensed(one, **device) + noise(30_000, seed + 1)),
        (two, sensed(two, **device) + noise(30_000, seed + 2)),
    )


def transformed(campaign, *, drive=lambda v: v, sense=lambda y: y, **changes):
    """The campaign with functions applied to the drive and sense samples of every record."""
    records = (dataclasses.replace(r, drive_v=drive(r.drive_v), sense_v=sense(r.sense_v)) for r in campaign.records)
    return dataclasses.replace(campaign, records=tuple(records), **changes)


def merged(text, patch):
    """campaign.toml with the lines of a patch written or replaced, as a user would do it."""
    old, new = msgspec.toml.decode(text), msgspec.toml.decode(patch)
    for name, table in new.items():
        if name != "record":
            old[name] = {**old.get(name, {}), **table}
    for entry in new.get("record", []):
        next(e for e in old["record"] if e["file"] == entry["file"]).update(entry)
    return old


def toml_of(tree):
    tables = [toml_table(f"[{name}]", values) for name, values in tree.items() if name != "record"]
    return "\n".join([*tables, *(toml_table("[[record]]", entry) for entry in tree["record"])])


def corrected(campaign, folder) -> tuple[CheckReport, Campaign]:
    """Write the campaign, check it, apply the printed lines to campaign.toml, and read it again."""
    write_campaign(campaign, folder)
    report = check(read_campaign(folder))
    path = folder / "campaign.toml"
    path.write_text(toml_of(merged(path.read_text(), report.toml)))
    return report, read_campaign(folder)


def kinds(report):
    return {finding.kind for finding in report.findings if finding.severity != "note"}
