"""The paper's route on one record: bandpass, ARX, modes, phase correction, gains, the four thetas.

    v, S --(12)--> ARX --> three modes --hold inverted--> H(s) --(16)--> M_1, M_2, M_3 --(18)--> theta

Modes are assigned by the in-phase share c: the up-down mode moves all pick-offs alike, whichever drive excites it, so with

    c = sum_{ab} M[a, b] / (2 |M|_F)

c = 1 for a pure translation and c = (cos 2theta - 1)/2 <= 0 for a mode that rocks about theta.  With all senses (or
all drives) reversed c = -1 for the translation and a rocking mode can be mistaken for it.  The mode that is isolated in
frequency then reveals the reversal.
Shapes: N samples, S = 2 senses, D = 2 drives, modes in the order lower rocking, upper rocking, up-down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import ComplexArray, FloatArray
from ..experiment.files.modal_record import ModalRecord
from ..experiment.instrument import AntiAlias, Instrument
from ..experiment.record import Record
from .arx import fit_arx
from .axes import Axes, Gains, axes, gains_from_updown
from .bandpass import bandpass, window_slice
from .failure import IdentificationError
from .modes import ContinuousModes, modes_from_fractions, modes_of, to_continuous
from .phase import correct_phase, without_filter

#: In-phase share above which a mode is up-down (a tilt of 0.5 still is), and below which it rocks.
_UPDOWN_SHARE = 0.8
_ROCKING_SHARE = 0.5
#: In-phase share beyond which a mode is a translation with one sign reversed.
_REVERSED_SHARE = -0.9
#: A mode is isolated when it is this many times farther from the other two than they are from each other.
_ALONE = 10.0


@dataclass(frozen=True, eq=False)
class RouteResult:
    """The result of the route; modes in the order lower rocking, upper rocking, up-down.

    filtered : modes as identified, the anti-alias filter included.
    mechanical : the same with the filter divided out exactly, R_k / G_aa(p_k).
    M : (3, 2, 2) phase-corrected first Markov parameters M_1, M_2, M_3 [1/s], eq. (17).
    gains, axes : Section 4.2 of the paper.
    """

    filtered: ContinuousModes
    mechanical: ContinuousModes
    M: FloatArray
    gains: Gains
    axes: Axes

    @property
    def poles(self) -> ComplexArray:
        """p (3,) [rad/s]."""
        return self.mechanical.poles

    @property
    def residues(self) -> ComplexArray:
        """R (3, S, D) of H(s) = sum R/(s - p) + conj without the anti-alias filter [1/s]."""
        return self.mechanical.residues

    @property
    def residues_filtered(self) -> ComplexArray:
        """R (3, S, D) with the anti-alias filter included [1/s]."""
        return self.filtered.residues

    @property
    def f_hz(self) -> FloatArray:
        """|p| / 2pi (3,) [Hz]."""
        return self.mechanical.frequency_hz

    @property
    def zeta(self) -> FloatArray:
        """Damping ratio -Re p / |p| (3,) [1]."""
        return self.mechanical.zeta

    @property
    def arx_split_hz(self) -> float:
        """Difference of the rocking frequencies [Hz]; that of the stiffness axes where c12 = 0."""
        return float(self.f_hz[1] - self.f_hz[0])


def _isolated_mode(frequency_hz: FloatArray) -> int | None:
    """Which of three modes is far from the other two, if any."""
    gaps = np.diff(frequency_hz)
    if gaps[1] > _ALONE * gaps[0]:
        return 2
    return 0 if gaps[0] > _ALONE * gaps[1] else None


def assign_modes(modes: ContinuousModes, M: FloatArray) -> tuple[int, int, int]:
    """Indices of (lower rocking, upper rocking, up-down) among three modes with matrices M (3, 2, 2) [1/s].

    Raises
    ------
    IdentificationError : not exactly one of the three modes moves all pick-offs alike.
    """
    share = M.sum(axis=(1, 2)) / (2.0 * np.sqrt(np.square(M).sum(axis=(1, 2))))
    updown = int(np.argmax(share))
    alone = _isolated_mode(modes.frequency_hz)
    if alone not in (None, updown) and share[alone] < _REVERSED_SHARE:
        raise IdentificationError(
            "all senses or all drives are reversed",
            value=f"in-phase share {share[alone]:+.2f} of the mode at {modes.frequency_hz[alone]:.2f} Hz",
            allowed="+1 for the up-down mode",
            next_step="change the sign of both sense columns, or of both drive columns",
        )
    rocking = [k for k in np.argsort(modes.frequency_hz) if k != updown]
    if not share[updown] > _UPDOWN_SHARE or not np.all(share[rocking] < _ROCKING_SHARE):
        shown = ", ".join(f"{f:.2f} Hz: {c:+.2f}" for f, c in zip(modes.frequency_hz, share))
        raise IdentificationError(
            "no two rocking modes and one up-down mode among the three strongest",
            value=f"in-phase share {shown}",
            allowed=f"one mode above {_UPDOWN_SHARE}, two below {_ROCKING_SHARE}",
            next_step="check polarity and order of the channels, and that the band holds all three modes",
        )
    return int(rocking[0]), int(rocking[1]), updown


def route_from_modes(modes: ContinuousModes, antialias: AntiAlias | None) -> RouteResult:
    """Phase correction, gains and axes of three modes with the filter included.

    Raises
    ------
    IdentificationError : not two rocking modes and one up-down mode, two drives and two senses.
    """
    if modes.residues.shape != (3, 2, 2):
        raise IdentificationError(
            "the route of the paper needs three modes, two senses and two drives",
            value=modes.residues.shape,
            allowed="(3, 2, 2)",
            next_step='use plant = { kind = "modal" } for other devices',
        )
    M = correct_phase(modes, antialias)
    order = list(assign_modes(modes, M))
    ordered = ContinuousModes(modes.poles[order], modes.residues[order])
    M = M[order]
    gains = gains_from_updown(M[2])
    return RouteResult(ordered, without_filter(ordered, antialias), M, gains, axes(M[0], M[1], gains))


def identify_record(
    record: Record,
    instrument: Instrument,
    order: int = 40,
    band_hz: tuple[float, float] = (400.0, 700.0),
    window_s: float = 2.0,
    ridge: float = 1e-12,
    filtered_drive_v: FloatArray | None = None,
) -> RouteResult:
    """The whole route on one record.

    Parameters
    ----------
    record : two drives, two senses, any initial state.
    instrument : its hold and anti-alias filter are taken out.
    order : of the ARX model, 10 to 80 [samples].
    band_hz : corners of the bandpass, and where modes are looked for [Hz].
    window_s : length of the window around the largest signal [s].
    ridge : relative ridge of the ARX fit.
    filtered_drive_v : the drive behind the bandpass (N, 2) [V], where it is known already.

    Raises
    ------
    IdentificationError : the record does not determine two rocking modes and one up-down mode.
    """
    senses, drives = record.sense_v.shape[1], record.drive_v.shape[1]
    if (senses, drives) != (2, 2):
        raise IdentificationError(
            "the route of the paper needs two senses and two drives",
            value=f"{record.name}: {senses} senses, {drives} drives",
            allowed="2 and 2",
            next_step='use plant = { kind = "modal" } for other devices',
        )
    rate = record.sample_rate_hz
    sense = bandpass(record.sense_v, rate, *band_hz)
    drive = bandpass(record.drive_v, rate, *band_hz) if filtered_drive_v is None else filtered_drive_v
    window = window_slice(sense, rate, window_s)
    # With a first-order or band-limited hold a drive sample acts before and at its own time.
    direct = instrument.hold != "zoh"
    model = fit_arx(sense[window], drive[window], order, ridge, direct)
    modes = to_continuous(modes_of(model, rate, band_hz), rate, instrument.hold)
    return route_from_modes(modes, instrument.antialias)


def identify_modal(modal: ModalRecord) -> RouteResult:
    """The route from externally identified poles and residues.

    Raises
    ------
    IdentificationError : they are not two rocking modes and one up-down mode of two drives and two senses.
    """
    modes = modes_from_fractions(modal.frequency_hz, modal.zeta, modal.R1, modal.R0)
    return route_from_modes(modes, modal.antialias)
