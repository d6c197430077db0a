"""identify --stream from growing files, pipes and damaged records."""

import io
import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from pipeline.device.gyro import gyro_modes
from pipeline.errors import MeasurementError, UsageError
from pipeline.experiment.antialias import behind_filter
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.instrument import Instrument
from workflows.commands.stream import stream
from workflows.streaming.growing import record_blocks

RATE = 10_000.0
THETA = -33.2


@pytest.fixture(scope="module")
def lines() -> list[str]:
    """0.2 s of silence and 0.8 s of the paper's chirp on a device without an anti-alias filter, as CSV lines."""
    device = np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, THETA, 0.4, 13.33, 28.6, 0.0386, 0.0007])
    drive = np.concatenate([np.zeros((2_000, 2)), drive_samples(Chirp(), RATE)[:8_000]])
    instrument = Instrument()
    volts = respond(behind_filter(gyro_modes(device[None]), None), drive, RATE, instrument.hold)[0]
    sense = volts + 1e-3 * np.random.default_rng(1).standard_normal(volts.shape)
    rows = np.column_stack([np.arange(drive.shape[0]) / RATE, drive, sense])
    text = io.StringIO()
    np.savetxt(text, rows, delimiter=",", fmt=("%.4f", "%.17g", "%.17g", "%.17g", "%.17g"))
    return ["time_s,drive1_V,drive2_V,sense1_V,sense2_V\n", *io.StringIO(text.getvalue())]


def joined(blocks) -> tuple[np.ndarray, np.ndarray]:
    parts = list(blocks)
    return np.concatenate([p.drive_v for p in parts]), np.concatenate([p.sense_v for p in parts])


def test_a_growing_file_gives_every_sample_once_although_lines_arrive_in_parts(
    lines: list[str], tmp_path: Path
) -> None:
    text = "".join(lines[:4_001])
    whole, growing = tmp_path / "whole.csv", tmp_path / "growing.csv"
    whole.write_text(text)
    growing.write_text("")

    def write() -> None:
        with growing.open("a") as file:
            for first in range(0, len(text), 40_009):
                file.write(text[first : first + 40_009])
                file.flush()
                time.sleep(0.02)

    writer = threading.Thread(target=write)
    writer.start()
    found = joined(record_blocks(growing, None, 0.6))
    writer.join()
    expected = joined(record_blocks(whole, None, 0.05))
    assert found[0].shape == (4_000, 2)
    assert np.array_equal(found[0], expected[0])
    assert np.array_equal(found[1], expected[1])


def test_stream_reports_theta_and_split_with_sd_and_the_time_of_the_verdict(
    lines: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, limits = tmp_path / "record.csv", tmp_path / "limits.toml"
    file.write_text("".join(lines))
    limits.write_text("[limits.split_hz]\nmax = 3.0\n")
    stream(file, True, limits=limits, patience_s=0.05, every_s=0.3)
    found = json.loads(capsys.readouterr().out)
    assert [round(s["time_s"], 3) for s in found["steps"]] == [0.3, 0.6, 0.8]
    assert abs(found["theta_deg"] - THETA) < 4.0 * found["theta_deg_sd"] < 1.0
    assert abs(found["split_hz"] - 1.9) < 4.0 * found["split_hz_sd"] < 0.05
    assert (found["verdict"], found["decided_after_s"]) == ("pass", 0.3)
    # 1.8 sd inside the limit is too little while more may follow, and enough at the end of the record.
    limits.write_text(f"[limits.split_hz]\nmax = {found['split_hz'] + 1.8 * found['split_hz_sd']}\n")
    stream(file, True, limits=limits, patience_s=0.05, every_s=0.3)
    at_end = json.loads(capsys.readouterr().out)
    assert (at_end["steps"][-1]["verdict"], at_end["verdict"]) == ("undecided", "pass")
    assert at_end["decided_after_s"] == pytest.approx(0.8, abs=1e-3)
    limits.write_text("[limits.split_hz]\nmax = 1.5\n")
    stream(file, False, limits=limits, patience_s=0.05, decide=True)
    assert capsys.readouterr().out.splitlines()[-1] == "fail after 0.3 s of drive"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: [*rows[:700], "0.07,what,0,0,0\n", *rows[700:1200]], "line 701 is not a sample"),
        (lambda rows: [*rows[:700], *rows[900:2000]], "samples are missing"),
        (lambda rows: [*rows[:513], *rows[600:2000]], "time jumps"),
        (lambda rows: rows[1:1000], "does not name the columns"),
        (lambda rows: [], "does not name the columns"),
    ],
)
def test_a_damaged_record_is_refused_with_the_kind_of_damage(lines, tmp_path, change, message) -> None:
    file = tmp_path / "damaged.csv"
    file.write_text("".join(change(lines)))
    with pytest.raises(MeasurementError, match=message):
        joined(record_blocks(file, None, 0.05))


def test_a_record_without_drive_and_invalid_options_are_refused(lines: list[str], tmp_path: Path) -> None:
    file = tmp_path / "silent.csv"
    file.write_text("".join(lines[:1_500]))
    with pytest.raises(MeasurementError, match="before the drive started"):
        stream(file, True, patience_s=0.05)
    with pytest.raises(UsageError, match="--every"):
        stream(file, True, every_s=0.0)
    with pytest.raises(UsageError, match="order"):
        stream(file, True, order=100)
