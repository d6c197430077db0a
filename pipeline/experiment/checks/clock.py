"""Time columns that differ from the declared sample rate or from a uniform grid, within what the reader tolerates."""

from __future__ import annotations

from ..record import Campaign
from .finding import Correction, Finding


def clocks(campaign: Campaign) -> list[Finding]:
    """Jitter above 0.01 samples, and sample rates that differ by more than 1 ppm and three times their resolution."""
    found = []
    for record in campaign.records:
        if record.clock is None:
            continue
        relative = record.clock.sample_rate_hz / record.sample_rate_hz - 1.0
        # Rounded time stamps determine the rate no better than this.
        resolution = 2.0 * record.clock.jitter_samples / record.sense_v.shape[0]
        if record.clock.jitter_samples > 0.01:
            jitter = record.clock.jitter_samples
            text = (
                f"The time stamps lie up to {jitter:.2g} samples off a uniform grid. Export time_s with more digits; if"
                " the digits suffice, check the sampling clock for jitter."
            )
            found.append(Finding("clock", "warning", text, record.name, "time_s", jitter, None, "samples"))
        if abs(relative) > max(1e-6, 3.0 * resolution):
            rate = float(f"{record.clock.sample_rate_hz:.9g}")
            correction = Correction(instrument={"sample_rate_hz": rate})
            sd = resolution * rate
            text = (
                f"The time column gives a sample rate of {rate} Hz, but {record.sample_rate_hz} Hz is declared"
                f" ({relative * 1e6:+.1f} ppm). If the time stamps come from the sampling clock, {correction.advice}."
            )
            found.append(Finding("clock", "warning", text, record.name, "time_s", rate, sd, "Hz", correction))
    return found
