"""The page of a campaign that holds a sweep, the amplitudes of a decay, or a decay in samples: residuals, and the next record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from bokeh.document import Document

from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.envelopes import EnvelopeRecord
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Campaign, Record
from pipeline.experiment.tones import ToneCampaign, ToneRecord
from reports.learning.decay_view import DecayView
from reports.words.explore_loop import NO_DRIVE, NO_SPECTRUM
from tests.workflows.explore.pages import opened, settle, titled, words
from workflows.explore.campaign.bench import CampaignBench
from workflows.explore.campaign.session import CampaignSession

MODEL = Model(PlantSpec("modal", 1, "displacement"))
F0, WIDTH = 1000.0, 1.0


def decaying(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Times, and amplitudes of a decay with a drag that the model lacks."""
    t, g = np.linspace(0.0, 1.5, rows), np.pi * WIDTH
    return t, g / ((g + 3.0) * np.exp(g * t) - 3.0)


def amplitudes() -> ToneCampaign:
    t, a = decaying(120)
    random, sd = np.random.default_rng(7), 2e-3
    z = a + sd * (random.standard_normal(t.size) + 1j * random.standard_normal(t.size))
    record = EnvelopeRecord("ring", t, np.abs(z)[:, None], tuned_hz=F0, sd_v=np.full((t.size, 1), sd))
    return ToneCampaign("r", (), Instrument(1.0), envelopes=(record,))


def sweep() -> ToneCampaign:
    f = np.tile(np.linspace(F0 - 3.0, F0 + 3.0, 31), 2)
    s, random = 2j * np.pi * f, np.random.default_rng(3)
    y = 1e4 / (s**2 + 2 * np.pi * WIDTH * s + (2 * np.pi * F0) ** 2)
    sd = 5e-3 * np.abs(y).max()
    # A feedthrough that the model lacks.
    y = y + 10.0 * sd + sd * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    ones = np.ones((f.size, 1), dtype=np.complex128)
    record = ToneRecord("sweep", "frf", f, ones, y[:, None], sd_v=np.full((f.size, 1), sd), role="fit")
    return ToneCampaign("r", (record,), Instrument(1.0))


@pytest.fixture(scope="module")
def ring() -> CampaignBench:
    """The decay; its fits are made once."""
    return CampaignBench(amplitudes(), MODEL)


@pytest.fixture(scope="module")
def response() -> CampaignBench:
    """The frequency response; its fits are made once."""
    return CampaignBench(sweep(), MODEL)


def shown(bench: CampaignBench) -> Document:
    return opened(lambda document: CampaignSession(bench, document, "measured", "") and None)


def figure_of(document: Document, name: str):
    return next(one for one in document.models if getattr(one, "name", None) == name)


def curve(document: Document, name: str) -> dict[str, np.ndarray]:
    """The residual beside the given model in a figure."""
    data = next(one.data_source.data for one in figure_of(document, name).renderers if "y" in one.data_source.data)
    return {key: np.asarray(value) for key, value in data.items()}


def test_the_amplitudes_of_a_decay_are_drawn_by_time_and_by_level(ring):
    document = shown(ring)
    (view,) = ring.first
    assert isinstance(view, DecayView)
    rows = (view.measured_v - view.model_v)[:, 0] / 2e-3
    assert view.residual[:, 0] == pytest.approx(np.abs(rows))
    assert np.sqrt(np.mean(rows**2)) > 2.0
    for name in ("Residual by time", "Residual by level of the response"):
        assert np.sqrt(np.mean(curve(document, name)["y"] ** 2)) == pytest.approx(np.sqrt(np.mean(rows**2)), rel=1e-3)
    assert curve(document, "Residual by time")["x"][-1] == pytest.approx(1.5)
    assert not figure_of(document, "Residual by frequency").visible
    assert NO_SPECTRUM in words(document)
    titled(document, "Unit").value = "V"
    assert np.sqrt(np.mean(curve(document, "Residual by time")["y"] ** 2)) == pytest.approx(
        2e-3 * np.sqrt(np.mean(rows**2)), rel=1e-3
    )


@pytest.mark.parametrize(
    ("measured", "excitation", "figure"),
    [
        ("ring", "decay like ring", "Difference of the predictions by time"),
        ("response", "frequency response like sweep", "Difference of the predictions by frequency"),
    ],
)
def test_the_record_is_predicted_once_more_at_another_level(measured, excitation, figure, request):
    document = shown(request.getfixturevalue(measured))
    assert titled(document, "Excitation of the next record").options == [excitation]
    first = curve(document, figure)["y"].max()
    assert first > 1.0
    assert "with all parameters refitted" in words(document)
    scale = titled(document, "Level scale (1: as measured so far)")
    scale.value = 0.5
    scale.trigger("value_throttled", 1.0, 0.5)
    settle(document)
    assert "0.5 V" in words(document)
    assert curve(document, figure)["y"].max() < 0.7 * first
    assert 'role="alert"' not in words(document)


def test_a_decay_in_samples_says_that_no_drive_is_known():
    t, a = np.arange(1200) / 200.0, np.random.default_rng(2)
    y = np.exp(-0.4 * t) * np.cos(2 * np.pi * 20.0 * t) + 1e-3 * a.standard_normal(t.size)
    record = Record("free", 200.0, np.zeros((t.size, 0)), y[:, None], role="fit", at_rest=False)
    campaign = Campaign("r", (record, replace(record, name="again", role="validate")), Instrument(200.0))
    document = shown(CampaignBench(campaign, Model(PlantSpec("modal", 1, "displacement", 1, 0))))
    assert NO_DRIVE in words(document)
    assert 'role="alert"' not in words(document)
    assert "band of the drive" not in str(titled(document, "Band of the spectrum").options)
