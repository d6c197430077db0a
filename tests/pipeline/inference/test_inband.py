"""The in-band model is the Fourier transform of the exact simulation, and its Taylor series are its derivatives."""

from itertools import pairwise

import numpy as np
import pytest

from pipeline.device.gyro import gyro_modes
from pipeline.errors import ConfigError
from pipeline.experiment.antialias import behind_filter
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.inference.screening import columns
from pipeline.inference.screening.columns import feature_columns
from pipeline.inference.screening.inband import features, make_band

DEVICE = np.array([[534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007]])
DRIVE = drive_samples(Chirp(), 10_000.0)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("antialias", [AntiAlias(), None])
def test_the_band_model_is_the_transform_of_the_simulated_record(hold, antialias):
    instrument = Instrument(hold=hold, antialias=antialias)
    modes = gyro_modes(DEVICE)
    record = respond(behind_filter(modes, antialias), DRIVE, 10_000.0, hold)[0]
    band = make_band(DRIVE, instrument, 400.0, 700.0)
    model = np.zeros((2, band.bins.size), complex)
    for k in range(3):
        pole, residue = complex(modes.poles[0, k]), modes.residues[0, k]
        model += residue @ features(band, pole) + np.conj(residue) @ features(band, pole.conjugate())
    spectrum = band.transform(record)
    assert np.max(np.abs(spectrum - model)) < 1e-11 * np.max(np.abs(spectrum))


def of_unit_residue(columns, width):
    """Response (M, D, W) to each of three poles alone, in powers of its shift, from columns (2 W, J)."""
    real, imag = np.moveaxis(columns.T.reshape(3, 2, 4, 2, 2, width), 3, 0)
    # Columns are Phi(p) + Phi(conj p) and i {Phi(p) - Phi(conj p)}.
    plus, turned = real[..., 0, :] + 1j * real[..., 1, :], imag[..., 0, :] + 1j * imag[..., 1, :]
    return np.swapaxes(0.5 * (plus - 1j * turned), 1, 2), np.swapaxes(0.5 * (plus + 1j * turned), 1, 2)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("antialias", [AntiAlias(), None])
def test_the_taylor_series_in_the_pole_converges_at_its_order(hold, antialias):
    band = make_band(DRIVE, Instrument(hold=hold, antialias=antialias), 400.0, 700.0)
    poles, shift = gyro_modes(DEVICE).poles[0], 0.02 + 0.02j
    own, conjugate = of_unit_residue(feature_columns(band, poles), band.bins.size)
    for k, pole in enumerate(poles):
        for series, at, step in ((own[k], complex(pole), shift), (conjugate[k], complex(pole).conjugate(), shift)):
            exact = features(band, at + step)
            errors = [
                np.max(np.abs(sum(series[m] * step**m for m in range(order + 1)) - exact)) / np.max(np.abs(exact))
                for order in range(4)
            ]
            # The up-down mode is damped three times as much, so its series is a third as steep.
            assert all(after < before / 30.0 for before, after in pairwise(errors))
            assert errors[3] < 1e-7


def test_a_long_record_in_parts_has_the_features_of_the_whole(monkeypatch):
    band = make_band(DRIVE, Instrument(hold="foh"), 400.0, 700.0)
    poles = gyro_modes(DEVICE).poles[0]
    whole = feature_columns(band, poles)
    monkeypatch.setattr(columns, "SHORT", 7000)
    parts = feature_columns(band, poles)
    # Rounding of the end states grows at the bin next to a pole.
    np.testing.assert_allclose(parts, whole, rtol=0.0, atol=1e-11 * np.max(np.abs(whole)))


def test_a_hold_without_closed_form_is_refused():
    with pytest.raises(ConfigError, match="hold"):
        make_band(DRIVE, Instrument(hold="bandlimited"), 400.0, 700.0)
