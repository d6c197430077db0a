"""Free decays: pieces without a drive, each from its own free initial state, simulated by an integrator that shares no code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.arrays import FloatArray
from pipeline.device.model import Model, PlantSpec
from pipeline.errors import MeasurementError
from pipeline.experiment.campaign import read_campaign
from pipeline.experiment.decays.backbone import oscillations
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.general.fit import fit_campaign
from workflows.learning import diagnose, refine

RATE_HZ, F_HZ, ZETA = 2000.0, 100.0, 3e-3
OMEGA = 2.0 * np.pi * F_HZ


def decay(k3: float = 0.0, drag: float = 0.0, seconds: float = 2.0) -> FloatArray:
    """x'' + 2 zeta w x' + w^2 x + k3 x^3 + d |x'| x' = 0 (N,) from x = 1, x' = 0."""

    def slope(t: float, s: FloatArray) -> list[float]:
        x, v = s
        return [v, -(OMEGA**2) * x - 2.0 * ZETA * OMEGA * v - k3 * x**3 - drag * abs(v) * v]

    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.asarray(solve_ivp(slope, (0.0, t[-1]), [1.0, 0.0], "DOP853", t, rtol=1e-10, atol=1e-12).y[0])


def campaign(y: FloatArray, pieces: int, snr: float) -> Campaign:
    """``pieces`` of equal length of a decay (N,) with white noise; the second of every three is held out."""
    noisy = y + y.std() / snr * np.random.default_rng(5).standard_normal(y.size)
    parts = np.split(noisy[: y.size // pieces * pieces], pieces)
    return Campaign(
        "ring",
        tuple(
            Record(
                f"{k}", RATE_HZ, np.zeros((p.size, 0)), p[:, None], "validate" if k % 3 == 1 else "fit", at_rest=False
            )
            for k, p in enumerate(parts)
        ),
        Instrument(RATE_HZ),
    )


RESONATOR = Model(PlantSpec("modal", 1, "displacement"))


def test_a_linear_decay_is_adequate_and_gives_frequency_and_damping() -> None:
    found = refine(campaign(decay(), 4, 100.0), RESONATOR).answer
    assert (found.verdict, tuple(found.effects)) == ("adequate", ())
    for name, truth in (("f1_hz", F_HZ), ("zeta1", ZETA)):
        value, sd = found.parameters[name]
        assert abs(value - truth) < 3.5 * sd
        assert sd < 3e-3 * truth


def test_gain_noise_of_a_decay_is_a_component_of_the_noise_and_no_misfit() -> None:
    random = np.random.default_rng(11)
    y = decay(seconds=6.0)
    noisy = y * (1.0 + 0.02 * random.standard_normal(y.size)) + 1e-3 * random.standard_normal(y.size)
    silence = 1e-3 * random.standard_normal(8000)
    parts = [("decay", noisy, "fit"), ("silence", silence, "noise")]
    records = tuple(
        Record(name, RATE_HZ, np.zeros((v.size, 0)), v[:, None], role, at_rest=False) for name, v, role in parts
    )
    found = refine(Campaign("ring", records, Instrument(RATE_HZ)), RESONATOR).answer
    assert (found.verdict, tuple(found.effects)) == ("adequate", ())
    assert found.noise.gain_noise == pytest.approx(0.02, rel=0.1)
    for name, truth in (("f1_hz", F_HZ), ("zeta1", ZETA)):
        value, sd = found.parameters[name]
        assert abs(value - truth) < 3.5 * sd


@pytest.mark.parametrize(
    ("effect", "size", "pieces"),
    [("cubic_stiffness.k3", 0.05 * OMEGA**2, 10), ("nonlinear_damping.d", 2e-2, 6)],
)
def test_one_ring_down_names_its_effect(effect: str, size: float, pieces: int) -> None:
    law = effect.partition(".")[0]
    y = decay(k3=size) if law == "cubic_stiffness" else decay(drag=size)
    found = refine(campaign(y, pieces, 100.0), RESONATOR).answer
    assert (found.verdict, tuple(found.effects)) == ("adequate", (law,))
    assert found.ladder[1].status == "confirmed"
    value, sd = found.parameters[effect]
    assert abs(value - size) < 3.5 * sd
    assert sd < 0.02 * size


def test_a_clip_level_is_scanned_from_the_fitted_states() -> None:
    """From rest a decay has no motion to clip: the level stayed where its grid begins, at an error of 43."""
    measured = campaign(decay(), 4, 1000.0)
    clipped = replace(
        measured, records=tuple(replace(r, sense_v=np.clip(r.sense_v, -0.8, 0.8)) for r in measured.records)
    )
    fit = fit_campaign(RESONATOR.with_effect("adc_saturation"), clipped, noise_level(measured))
    assert fit.converged
    assert fit.error["fit"] == pytest.approx(1.0, abs=0.1)
    value, sd = fit.parameters["adc_saturation.1/level"]
    assert abs(value - 1.25) < 4.0 * sd


def written(folder: Path, text: str, drive: bool = False) -> Path:
    """A campaign of one file: a burst of 0.1 s, then a ring-down to far below the noise."""
    t = np.arange(8000) / RATE_HZ
    ring = np.where(t < 0.1, 0.5, np.exp(-ZETA * OMEGA * t) * np.cos(OMEGA * t))
    columns = [t, ring + 1e-2 * np.random.default_rng(2).standard_normal(t.size)]
    if drive:
        columns.append(np.where(t < 0.1, np.sin(700.0 * t), 0.0))
    header = "time_s,sense1_V" + ",drive1_V" * drive
    np.savetxt(folder / "ring.csv", np.stack(columns, axis=1), delimiter=",", header=header, comments="")
    (folder / "campaign.toml").write_text(text)
    return folder


@pytest.mark.parametrize(("keys", "drive"), [("start_s = 0.1", False), ("", True)])
def test_a_decay_is_read_as_pieces_and_the_silence_behind_it(tmp_path: Path, keys: str, drive: bool) -> None:
    text = f'[[record]]\nfile = "ring.csv"\nkind = "decay"\n{keys}\n'
    *pieces, silence = read_campaign(written(tmp_path, text, drive)).records
    assert len(pieces) == 6
    assert [piece.role for piece in pieces] == ["fit", "validate", "fit", "fit", "validate", "fit"]
    assert all(piece.drive_v.shape[1] == 0 and not piece.at_rest for piece in pieces)
    assert sum(piece.sense_v.shape[0] for piece in (*pieces, silence)) == pytest.approx(7800, abs=1)
    assert silence.role == "noise"
    # e^(-zeta omega t) has fallen below a tenth of the noise.
    assert np.exp(-ZETA * OMEGA * (0.1 + silence.elapsed_s)) < 2e-3
    assert silence.sense_v.std() == pytest.approx(1e-2, rel=0.05)


def test_a_decay_whose_drive_never_stops_is_refused_with_a_way_out(tmp_path: Path) -> None:
    written(tmp_path, '[[record]]\nfile = "ring.csv"\nkind = "decay"\nstop_s = 0.1\n', True)
    with pytest.raises(MeasurementError, match="does not stop"):
        read_campaign(tmp_path)


def test_frequency_and_damping_of_a_piece_are_covered_without_a_model() -> None:
    random, z = np.random.default_rng(4), []
    t = np.arange(600) / RATE_HZ
    for _ in range(40):
        y = np.exp(-ZETA * OMEGA * t) * np.cos(OMEGA * np.sqrt(1.0 - ZETA**2) * t + random.uniform(0.0, 6.0))
        y += 0.3 * np.exp(-30.0 * t) * np.cos(2.0 * np.pi * 170.0 * t) + 0.05 * random.standard_normal(t.size) + 3.0
        one = oscillations(y, RATE_HZ, [101.0, 171.0])[0]
        z.append([(one.f_hz - F_HZ) / one.f_sd_hz, (one.zeta - ZETA) / one.zeta_sd])
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.5 / np.sqrt(40.0))
    assert np.all(np.abs(np.std(z, axis=0) - 1.0) < 0.4)


def test_a_drift_goes_on_from_piece_to_piece() -> None:
    t = np.arange(3000) / RATE_HZ
    model = RESONATOR.with_channels(1, 0).with_effect("frequency_drift").with_effect("gain_drift")
    values = {"f1_hz": F_HZ, "zeta1": ZETA, "frequency_drift.beta": -0.02, "gain_drift.gamma": 0.1}
    whole = Record("run", RATE_HZ, np.zeros((t.size, 0)), np.zeros((t.size, 1)), "fit", at_rest=False)
    y = forward(model, values, whole, Instrument(RATE_HZ), start=np.array([1.0, 0.0]))
    # Without the laws of time, the state at a later sample continues the run: x = y / (1 + gamma t) there.
    half = replace(whole, drive_v=whole.drive_v[1500:], sense_v=whole.sense_v[1500:], elapsed_s=t[1500])
    x = y[:, 0] / (1.0 + 0.1 * t)
    state = np.array([x[1500], (8.0 * (x[1501] - x[1499]) - (x[1502] - x[1498])) * RATE_HZ / 12.0])
    again = forward(model, values, half, Instrument(RATE_HZ), start=state)
    assert np.max(np.abs(again - y[1500:])) < 2e-3 * np.max(np.abs(y[1500:]))
    restarted = forward(model, values, replace(half, elapsed_s=0.0), Instrument(RATE_HZ), start=state)
    assert np.max(np.abs(restarted - y[1500:])) > 0.1 * np.max(np.abs(y[1500:]))


def test_a_decay_says_that_nothing_states_the_force() -> None:
    found = diagnose(campaign(decay(seconds=1.0), 4, 100.0), RESONATOR).answer
    assert [text for text in found.invisible if "units of the sense signal" in text]
