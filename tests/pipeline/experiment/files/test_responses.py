"""Frequency responses from Touchstone, UFF58 and text files, and the quantities that they hold."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import GyroscreenError
from pipeline.experiment.files.readers import read_columns
from pipeline.experiment.files.tone_columns import tone_record

F = np.linspace(1e6, 1.2e6, 21)


def admittance(f):
    """A resonator with its static capacitance, in siemens."""
    s = 2j * np.pi * f
    return 1e-12 * s + 4e-3 * s * 2e4 / (s**2 + 2e4 * s + (2 * np.pi * 1.1e6) ** 2)


def test_scattering_parameters_become_the_admittance(tmp_path):
    y = admittance(F)
    for form, pair in (
        ("RI", lambda s: (s.real, s.imag)),
        ("DB", lambda s: (20 * np.log10(abs(s)), np.rad2deg(np.angle(s)))),
    ):
        s = (1 - 75.0 * y) / (1 + 75.0 * y)
        rows = np.stack([F / 1e6, *pair(s)], axis=1)
        np.savetxt(tmp_path / "r.s1p", rows, header=f"! a comment\n# MHz S {form} R 75", comments="", fmt="%.16g")
        found = read_columns(tmp_path / "r.s1p")
        assert np.allclose(found["H_s1d1_re"] + 1j * found["H_s1d1_im"], y, rtol=1e-9)
        assert np.allclose(found["frequency_hz"], F)


def test_a_two_port_is_inverted_as_a_matrix(tmp_path):
    y = np.array([[2e-3, -1e-3j], [5e-4 + 1e-3j, 3e-3j]])
    s = (np.eye(2) - 50 * y) @ np.linalg.inv(np.eye(2) + 50 * y)
    row = [1.0, *(part for z in (s[0, 0], s[1, 0], s[0, 1], s[1, 1]) for part in (z.real, z.imag))]
    (tmp_path / "t.s2p").write_text("# GHz S RI R 50\n" + " ".join(f"{v:.15g}" for v in row) + "\n")
    found = read_columns(tmp_path / "t.s2p")
    for j in (1, 2):
        for k in (1, 2):
            got = found[f"H_s{j}d{k}_re"][0] + 1j * found[f"H_s{j}d{k}_im"][0]
            assert got == pytest.approx(y[j - 1, k - 1], rel=1e-9)


def universal(h, response, binary=False):
    """Data set 58 of an accelerance, even abscissa from 10 Hz in steps of 2.5 Hz."""
    name = f"{'NONE':>10}"
    lines = ["x"] * 5 + [f"{4:5d}{0:10d}{1:5d}{0:10d} {name}{response:10d}{3:4d} {name}{1:10d}{3:4d}"]
    lines += [f"{6:10d}{h.size:10d}{1:10d}{10.0:13.5e}{2.5:13.5e}{0.0:13.5e}"]
    for kind, unit in ((18, "Hz"), (12, "m/s^2"), (13, "N"), (0, "NONE")):
        lines += [f"{kind:10d}{0:5d}{0:5d}{0:5d} {'NONE':>20} {unit:>20}"]
    values = np.stack([h.real, h.imag], axis=1).reshape(-1)
    head = "    58b     1     2          11" + f"{values.size * 8:12d}" if binary else "    58"
    text = ("    -1\n" + head + "\n" + "\n".join(lines) + "\n").encode()
    if binary:
        return text + values.astype("<f8").tobytes() + b"    -1\n"
    return (
        text
        + "".join(f"{v:20.12e}" + ("\n" if k % 4 == 3 else "") for k, v in enumerate(values)).encode()
        + b"\n    -1\n"
    )


@pytest.mark.parametrize("binary", [False, True])
def test_universal_files_hold_mobilities_of_every_path(tmp_path, binary):
    f = 10.0 + 2.5 * np.arange(16)
    responses = [(1.0 + 2.0j) * f, (3.0 - 1.0j) * f]
    (tmp_path / "m.uff").write_bytes(b"".join(universal(h, j, binary) for j, h in enumerate(responses, 1)))
    found = read_columns(tmp_path / "m.uff")
    assert np.allclose(found["frequency_hz"], f)
    for j, h in enumerate(responses, 1):
        assert np.allclose(found[f"H_s{j}d1_re"] + 1j * found[f"H_s{j}d1_im"], h / (2j * np.pi * f), rtol=1e-10)


def test_quantities_and_coherence():
    h = admittance(F)
    columns = {
        "frequency_hz": F,
        "H_s1d1_re": (1 / h).real,
        "H_s1d1_im": (1 / h).imag,
        "H_s1d1_coherence": np.full(21, 0.8),
    }
    (found,) = tone_record("z", "frf", [columns], {}, quantity="impedance", averages=8)
    assert np.allclose(found.sense_v[:, 0], h)
    # sd of 1 / H from the coherence: |H| sqrt((1 - c) / (2 n c)) relative to |H|.
    assert np.allclose(found.sd_v[:, 0] / np.abs(h), np.sqrt(0.2 / (2 * 8 * 0.8)))
    reflected = (1 - 50 * h) / (1 + 50 * h)
    columns = {"frequency_hz": F, "H_s1d1_abs": abs(reflected), "H_s1d1_phase_deg": np.rad2deg(np.angle(reflected))}
    (found,) = tone_record("s", "frf", [columns], {}, quantity="S11", reference_ohm=50.0)
    assert np.allclose(found.sense_v[:, 0], h)
    with pytest.raises(GyroscreenError, match="no column H_s1d1_re"):
        tone_record("s", "frf", [{"frequency_hz": F}], {})
