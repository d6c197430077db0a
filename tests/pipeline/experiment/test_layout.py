"""Other electrodes than the paper's: theta and split of a device that was simulated electrode by electrode."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.errors import ConfigError
from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.layout import layout_of
from pipeline.inference.identify import identify

RATE, THETA, F, Q = 8000.0, 27.0, (1000.0, 1001.2), (900.0, 1200.0)
PAIR = [[1.0, 0.0], [0.0, 1.0]]
TURNED = [[math.cos(0.5), math.sin(0.5)], [-math.sin(0.5), math.cos(0.5)]]
FOUR = [[1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [-1.0, 0.0, 1.0], [0.0, -1.0, 1.0]]
PAPER_S, PAPER_D = [[-1.0, -1.0], [1.0, -1.0]], [[-1.0, 1.0], [1.0, 1.0]]


def simulated(senses: list[list[float]], drives: list[list[float]], v: np.ndarray) -> np.ndarray:
    """q'' + w/Q q' + w^2 q = t.v of each axis under held drives, and the columns that measure q'."""
    z = 0.3 if len(senses) > 2 else 0.0
    angle, out = math.radians(THETA), np.zeros((v.shape[0], len(senses)))
    axes = [(math.cos(angle), math.sin(angle), 0.0), (-math.sin(angle), math.cos(angle), 0.0), (0.0, 0.0, z)]
    for f, q, axis in zip((*F, 1150.0), (*Q, 300.0), np.array(axes)):
        p = complex(-math.pi * f / q, 2.0 * math.pi * f * math.sqrt(1.0 - 0.25 / q**2)) / RATE
        row = [np.array([*r, 0.0])[:3] @ axis for r in drives]
        x = lfilter([0.0, (np.exp(p) - 1.0) / p], [1.0, -np.exp(p)], v @ row)
        out += np.outer(2.0 * (p / (2j * p.imag) * x).real / RATE, [np.array([*r, 0.0])[:3] @ axis for r in senses])
    return out


def written(folder: Path, senses: list[list[float]], drives: list[list[float]]) -> Path:
    random, t = np.random.default_rng(3), np.arange(8000) / RATE
    up = np.sin(2.0 * np.pi * (900.0 * t + 100.0 * t**2))
    down = np.sin(2.0 * np.pi * (1100.0 * t - 100.0 * t**2))
    both = [np.stack([up, down, -0.3 * up, 0.5 * down], axis=1), np.stack([down, up, 0.6 * down, -0.2 * up], axis=1)]
    both = [v[:, : len(drives)] for v in both]
    # Gains of single electrodes, where they remain gains of a channel.
    gains = np.array([1.02, 0.97]) if len(senses) == 2 else np.ones(len(senses))
    clean = [simulated(senses, drives, v * (gains if len(drives) == 2 else 1.0)) * gains for v in both]
    sigma = 1e-3 * np.std(clean[0], axis=0)
    for name, v, y in zip(("silence", "a", "b"), (0.0 * both[0], *both), (0.0 * clean[0], *clean)):
        names = [*(f"drive{k + 1}_V" for k in range(v.shape[1])), *(f"sense{k + 1}_V" for k in range(y.shape[1]))]
        noisy = y + sigma * random.standard_normal(y.shape)
        np.savetxt(folder / f"{name}.csv", np.hstack([v, noisy]), "%.9e", ",", header=",".join(names), comments="")
    entries = [("silence", "noise"), ("a", "fit"), ("b", "fit")]
    files = "".join(f'[[record]]\nfile = "{name}.csv"\nrole = "{role}"\n' for name, role in entries)
    head = f"[instrument]\nsample_rate_hz = {RATE}\nbias_v = 5.0\n[layout]\nsenses = {senses}\ndrives = {drives}\n"
    (folder / "campaign.toml").write_text(head + files)
    return folder


@pytest.mark.parametrize(
    ("senses", "drives"),
    [(PAIR, PAIR), (TURNED, PAIR), (FOUR, FOUR), (PAPER_S, PAPER_D)],
    ids=["pair per axis", "senses turned", "four electrodes", "paper without up-down mode"],
)
def test_theta_and_split_are_those_of_the_device(tmp_path: Path, senses, drives) -> None:
    found = identify(read_campaign(written(tmp_path, senses, drives))).columns
    assert found["status"] == "ok", found["status_reason"]
    assert abs(found["theta_deg"] - THETA) < 4.0 * found["theta_deg_sd"] < 0.2
    assert abs(found["split_hz"] - (F[1] - F[0])) < 4.0 * found["split_hz_sd"] < 0.002
    assert "f3_hz" not in found


def test_a_campaign_with_a_layout_is_written_and_read(tmp_path: Path) -> None:
    campaign = read_campaign(written(tmp_path, TURNED, PAIR))
    write_campaign(campaign, tmp_path / "copy")
    again = read_campaign(tmp_path / "copy")
    assert again.frame.updown == campaign.frame.updown
    assert again.frame.angles_deg == pytest.approx(campaign.frame.angles_deg, abs=1e-9)
    for one, other in zip(campaign.records, again.records):
        assert np.array_equal(one.sense_v, other.sense_v)
        assert np.array_equal(one.drive_v, other.drive_v)


def test_the_layout_of_the_paper_changes_nothing() -> None:
    layout = layout_of([[*row, 1.0] for row in PAPER_S], [[*row, 1.0] for row in PAPER_D])
    assert layout.frame.angles_deg == (0.0, 0.0)
    assert layout.frame.updown
    assert np.array_equal(layout.sense, np.eye(2))
    assert np.array_equal(layout.drive, np.eye(2))


@pytest.mark.parametrize(
    ("senses", "drives"),
    [([[1.0, 0.0], [2.0, 0.0]], PAIR), ([[1.0, 0.0, 1.0], [0.0, 1.0, -0.4]], PAIR), ([[1.0], [0.0]], PAIR)],
)
def test_electrodes_that_the_plant_cannot_have_are_refused(senses, drives) -> None:
    with pytest.raises(ConfigError, match="layout"):
        layout_of(senses, drives)
