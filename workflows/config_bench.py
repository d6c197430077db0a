"""The tables of a run configuration that describe the bench of virtual devices: excitation, instrument, noise, demodulation.

Their defaults are those of the paper's experiment.  They extend the tables of campaigns, with the same ranges.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from pipeline.experiment.excitation import Chirp, Excitation, Multisine
from pipeline.experiment.files.common_tables import (
    AdcBits,
    AdcTable,
    AntiAliasTable,
    DemodulationTable,
    FilterOrder,
    InstrumentTable,
    NotNegative,
    PhaseError,
    Positive,
)
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.source import Kind, NoiseKind
from pipeline.toml_files import MAY_BE_INFINITE
from pipeline.toml_keys import Meaning


class ExperimentTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The excitation, the silent record before it, and the effects with sizes drawn by the population that virtual devices have.

    The default has all linear ones.  The nightly model fits electrode mismatches if one of these two effects is named.
    One start, stop [Hz] and amplitude [V] for each drive; ``period_s`` [s] is that of the multisine.
    """

    kind: Annotated[
        Literal["chirp", "multisine"], Meaning("chirp: a sweep of the frequency; multisine: a periodic sum of sines")
    ] = "chirp"
    start_hz: Annotated[tuple[Positive, ...], Meaning("first frequency of each drive")] = (400.0, 700.0)
    stop_hz: Annotated[tuple[Positive, ...], Meaning("last frequency of each drive")] = (700.0, 400.0)
    amplitude_v: Annotated[tuple[NotNegative, ...], Meaning("amplitude of each drive")] = (2.0, 2.0)
    duration_s: Annotated[float, Meta(gt=0.0, le=600.0), Meaning("length of the driven record")] = 3.0
    period_s: Annotated[Positive, Meaning("period of the multisine")] = 3.0
    silence_s: Annotated[Positive, Meaning("length of the silent record before it")] = 1.0
    effects: Annotated[
        tuple[str, ...], Meaning("effects with sizes drawn by the population that virtual devices have")
    ] = ("electrode_mismatch", "updown_tilt")

    def excitation(self) -> Excitation:
        """The excitation that the table describes."""
        if self.kind == "chirp":
            return Chirp(self.start_hz, self.stop_hz, self.amplitude_v, self.duration_s)
        low = min(*self.start_hz, *self.stop_hz)
        high = max(*self.start_hz, *self.stop_hz)
        return Multisine(low, high, self.amplitude_v, self.duration_s, self.period_s)


class RunAntiAliasTable(AntiAliasTable, frozen=True, forbid_unknown_fields=True):
    """The analog filter before the converter; the default is the paper's."""

    order: FilterOrder = 8
    corner_hz: Positive = 4800.0


class RunAdcTable(AdcTable, frozen=True, forbid_unknown_fields=True):
    """The converter; the default is the paper's."""

    bits: AdcBits = 16
    full_scale_v: Positive = 10.0


class RunInstrumentTable(InstrumentTable, frozen=True, forbid_unknown_fields=True):
    """The instrument; the default is the paper's.  ``antialias = false`` and ``adc = false``: none."""

    sample_rate_hz: Annotated[Positive, Meaning("sample rate of all records")] = 10_000.0
    antialias: Annotated[
        RunAntiAliasTable | Literal[False], Meaning("analog filter before the converter; false: none")
    ] = RunAntiAliasTable()
    adc: Annotated[RunAdcTable | Literal[False], Meaning("converter; false: its rounding is not modelled")] = (
        RunAdcTable()
    )

    def instrument(self) -> Instrument:
        """The instrument that the table describes."""
        return self.built(self.sample_rate_hz)


class NoiseTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Noise level: sigma [V], or the SNR [dB] of each device (rms of the signal in the window over sigma); and its kind.

    ``coefficient`` belongs to "ar", ``corner_hz`` to "1/f", ``jitter_s`` to "jitter", ``gain_noise`` to "gain"; sigma of "1/f" is
    that of its white part.
    """

    sigma_v: Annotated[
        Positive | None, Meaning("standard deviation of the noise; absent: 0.001, unless snr_db is given")
    ] = None
    snr_db: Annotated[
        Annotated[float, Meta(ge=-400.0, extra=MAY_BE_INFINITE)] | None,
        Meaning("rms of the signal in the window over sigma, for each device, in place of sigma_v"),
    ] = None
    kind: Annotated[
        Kind, Meaning("white, autoregressive (ar), 1/f, jitter of the sampling instants, or gain noise")
    ] = "white"
    coefficient: Annotated[float, Meta(gt=-1.0, lt=1.0), Meaning('coefficient a of the noise "ar"', "1")] = 0.7
    corner_hz: Annotated[NotNegative, Meaning('frequency below which the noise "1/f" exceeds the white part')] = 1000.0
    jitter_s: Annotated[NotNegative, Meaning('sd of the sampling instants of the noise "jitter"')] = 3e-7
    gain_noise: Annotated[NotNegative, Meaning('sd of the gain from sample to sample of the noise "gain"', "1")] = 1e-3

    def noise_kind(self) -> NoiseKind:
        """The kind of noise that the table describes."""
        return NoiseKind(self.kind, self.coefficient, self.corner_hz, self.jitter_s, self.gain_noise)


class HumTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Mains hum: amplitudes [V] of the harmonics 1, 2, .. of ``frequency_hz`` [Hz]; an empty list means no hum."""

    frequency_hz: Annotated[Literal[50, 60], Meaning("mains frequency")] = 60
    amplitude_v: Annotated[
        tuple[NotNegative, ...], Meaning("amplitudes of the harmonics 1, 2, ..; an empty list: no hum")
    ] = (0.005, 0.002, 0.003, 0.001, 0.002, 0.0005, 0.001, 0.0005, 0.0005)


class RunDemodulationTable(DemodulationTable, frozen=True, forbid_unknown_fields=True):
    """Phase error of the demodulation, and the mode whose frequency is omega_0."""

    phase_error_deg: PhaseError = 1.0
