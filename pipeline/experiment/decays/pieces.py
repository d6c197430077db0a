"""A free decay as pieces, each of which begins in its own free state, and the silence behind it.

In one piece the frequency hardly changes, so that a model whose frequency is wrong elsewhere still keeps its phase.  A piece is
as long as its phase allows, and at most a sixth of the decay:

    |c2| (T/2)^2 <= ``_BEND`` rad,      phase = c0 + c1 t + c2 t^2 over a piece of duration T

Held-out pieces lie between the fitted ones, so both have all amplitudes.  Where the motion falls below the noise, the rest of the
record is silence and measures the noise.

    A^2 / 2 < ``_GONE`` s^2,      A: amplitude of the line, extrapolated from where it is seen; s: rms of the end of the record

Sources: multiple shooting, Bock (1983); analytic signal of free vibration: Feldman, Mech. Syst. Signal Process. 8 (1994) 119.

Shapes: N samples, S senses, B blocks.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.fft import fft, ifft

from ...arrays import ComplexArray, FloatArray
from ...errors import MeasurementError
from ..record import Record, Role
from .backbone import line_hz, strongest_channel

#: Largest bend of the phase over a piece [rad].  At 0.7 the first piece of a mode that stiffens by 2 % is off by 13 sd.
_BEND = 0.25
#: Cycles and samples that a piece has at least: it determines offset, amplitude, phase, frequency and damping.
_CYCLES, _SAMPLES = 8.0, 64
#: Pieces of a decay that bends little, and at most; factor between the lengths that are tried.
_FEW, _MANY, _STEP = 6, 96, 1.2
#: Amplitude over that at the end of the record from which on the phase is clear.
_CLEAR = 5.0
#: Share of the noise variance that the motion has at most in silence.
_GONE = 1e-2
#: Blocks in which the line is sought, its significance chi2/2 where it is seen, and the shortest silence [samples].
_BLOCKS, _SEEN, _SILENCE = 48, 20.0, 256


def analytic(record: Record, f_hz: float) -> ComplexArray:
    """The analytic signal (N,) of the channel that moves most, in a band of +-40 % around ``f_hz``."""
    y = strongest_channel(record.sense_v)
    f = np.abs(np.fft.fftfreq(y.size, 1.0 / record.sample_rate_hz))
    edge = np.clip((0.4 - np.abs(f / f_hz - 1.0)) / 0.1, 0.0, 1.0)
    positive = np.fft.fftfreq(y.size) > 0.0
    return np.asarray(ifft(2.0 * fft(y) * np.sin(0.5 * np.pi * edge) ** 2 * positive))


def silence_from(record: Record, f_hz: float) -> int:
    """First sample of the silence behind a decay; N where the record ends before the motion is gone."""
    samples = record.sense_v.shape[0]
    y, width = strongest_channel(record.sense_v), samples // _BLOCKS
    if width < max(_SAMPLES, 2.0 * record.sample_rate_hz / f_hz):
        return samples
    t = np.arange(width) / record.sample_rate_hz
    # The line may lie off f_hz by what an amplitude-dependent frequency moves; a window of a block does not resolve it.
    taper = np.hanning(width)
    wave = taper * np.exp(-2j * np.pi * f_hz * t)
    blocks = y[: width * _BLOCKS].reshape(_BLOCKS, width)
    blocks = blocks - blocks.mean(axis=1, keepdims=True)
    amplitude = 2.0 * np.abs(blocks @ wave) / taper.sum()
    power = np.var(blocks, axis=1)
    rest = np.maximum(power - 0.5 * amplitude**2, 1e-300)
    chi2 = amplitude**2 * taper.sum() ** 2 / (4.0 * np.sum(taper**2) * rest)
    unseen = _BLOCKS - int(np.argmax(chi2[::-1] > _SEEN)) if np.any(chi2 > _SEEN) else _BLOCKS
    if unseen >= _BLOCKS or unseen < 2:
        return samples
    noise = float(np.median(rest[unseen:]))
    seen = np.flatnonzero(chi2[:unseen] > _SEEN)[-8:]
    if seen.size < 2:
        return samples
    rate, level = np.polyfit(seen, np.log(amplitude[seen]), 1)
    if rate >= 0.0:
        return samples
    end = int(np.ceil(((0.5 * np.log(2.0 * _GONE * noise) - level) / rate + 1.0) * width))
    return end if samples - end >= _SILENCE else samples


def _bend(phase: FloatArray, weight: FloatArray) -> float:
    """|c2| (T/2)^2 [rad] of a piece, weighted with the square of the motion."""
    x = np.linspace(-1.0, 1.0, phase.size)
    root = np.sqrt(weight)[:, None]
    basis = np.stack([np.ones(x.size), x, x**2], axis=1)
    return abs(float(np.linalg.lstsq(basis * root, phase * root[:, 0], rcond=None)[0][2]))


def edges_of(record: Record, f_hz: float) -> list[int]:
    """First samples of the pieces of a decay, and its end."""
    samples, rate = record.sense_v.shape[0], record.sample_rate_hz
    least = int(np.ceil(max(_CYCLES * rate / f_hz, _SAMPLES)))
    most = max(samples // _FEW, least)
    if samples < 2 * least:
        return [0, samples]
    z = analytic(record, f_hz)
    amplitude, phase = np.abs(z), np.unwrap(np.angle(z))
    # The ends of an analytic signal ring, and noise has a phase of its own.
    cut = max(int(2.0 * rate / f_hz), samples // 200)
    tail = np.median(amplitude[-cut - max(samples // 20, 8) : -cut])
    faint = int(np.argmax(amplitude[cut:] < _CLEAR * tail))
    clear = cut + faint if faint else samples - cut

    def length_from(first: int) -> int:
        length = most
        while length > least:
            seen = slice(max(first, cut), min(first + length, clear))
            if seen.stop - seen.start < least // 2 or _bend(phase[seen], amplitude[seen] ** 2) <= _BEND:
                break
            length = max(int(length / _STEP), least)
        return length

    edges = [0]
    while samples - edges[-1] >= least and len(edges) <= _MANY:
        edges.append(min(edges[-1] + length_from(edges[-1]), samples))
    # A remainder that is too short belongs to the piece before it.
    edges[-1] = samples
    return edges


def decay_pieces(record: Record, role: Role | None) -> tuple[Record, ...]:
    """The pieces of a free decay and its silence, if any, as records without drives.

    Parameters
    ----------
    record : the decay; a drive in it has stopped before, or its samples up to the last driven one are left out.
    role : of the pieces; ``None`` holds out the second of every three.

    Raises
    ------
    MeasurementError : the drive does not stop within the record, or nothing moves.
    """
    record = _after_drive(record)
    f_hz = line_hz(record.sense_v, record.sample_rate_hz)
    if f_hz <= 0.0:
        raise MeasurementError(
            f"{record.name}: nothing decays", allowed="a record that begins in motion", next_step="check [columns]"
        )
    samples = silence_from(record, f_hz)
    moving = _part(record, 0, samples, record.name, role)
    edges = edges_of(moving, f_hz)
    count = len(edges) - 1
    out = []
    for k, (first, stop) in enumerate(pairwise(edges)):
        own: Role = role if role is not None else "validate" if count > 1 and k % 3 == 1 else "fit"
        name = record.name if count == 1 else f"{record.name} {k + 1}/{count}"
        out.append(_part(record, first, stop, name, own))
    if samples < record.sense_v.shape[0]:
        out.append(_part(record, samples, record.sense_v.shape[0], f"{record.name} silence", "noise"))
    return tuple(out)


def _part(record: Record, first: int, stop: int, name: str, role: Role | None) -> Record:
    return replace(
        record,
        name=name,
        drive_v=np.zeros((stop - first, 0)),
        sense_v=record.sense_v[first:stop],
        role=role,
        at_rest=False,
        elapsed_s=record.elapsed_s + first / record.sample_rate_hz,
    )


def _after_drive(record: Record) -> Record:
    """The part behind the last driven sample, from where the drive stays at its last value."""
    off = record.drive_v - record.drive_v[-1:]
    peak = float(np.max(np.abs(off), initial=0.0))
    driven = np.flatnonzero(np.any(np.abs(off) > 1e-3 * peak, axis=1)) if peak > 0.0 else np.zeros(0, dtype=np.int64)
    first = int(driven[-1]) + 2 if driven.size else 0
    if record.sense_v.shape[0] - first < _SAMPLES:
        raise MeasurementError(
            f"{record.name}: the drive does not stop before the end of the record",
            value=f"{record.sense_v.shape[0] - first} samples behind the last driven one",
            allowed=f'at least {_SAMPLES} for kind = "decay"',
            next_step="state start_s, the time [s] at which the motion becomes free, if the drive column is no drive",
        )
    return record if first == 0 else _part(record, first, record.sense_v.shape[0], record.name, record.role)
