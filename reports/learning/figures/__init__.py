"""The figures of a campaign's page, from its records and its content: name -> SVG text, "" where nothing can be drawn."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...words.campaign import effect_words, listed
from ..content import CampaignContent
from ..record_view import RecordView, by_level, drive_band, drive_frequency, spectra, time_frequency
from .channels import ChannelError, channel_errors
from .ladder import LadderPoint, ladder_plot
from .level import LevelCurve, level_plot
from .resonance import ResonancePanel, resonance_plot
from .spectrogram import SpectrogramRow, spectrograms

#: Records that are pictured: pictures of all would bury what they show.
_PICTURED = 3
_RESONANCES = 4
#: Most records in the figures of level and channels.
_RECORDS = 24


@dataclass(frozen=True)
class Picture:
    """A figure about one record: its name, a note on it, what is shown, and the SVG text."""

    record: str
    note: str
    what: str
    svg: str


@dataclass(frozen=True)
class CampaignFigures:
    """All figures; empty where nothing can be drawn."""

    ladder: str
    resonances: tuple[Picture, ...]
    spectrograms: tuple[Picture, ...]
    level: str
    channels: str


@dataclass(frozen=True)
class Window:
    """Resonances [Hz] that are pictured together, and how far the picture reaches beyond them."""

    centres_hz: tuple[float, ...]
    half_hz: float

    @property
    def band_hz(self) -> tuple[float, float]:
        """From below the first to above the last."""
        return max(self.centres_hz[0] - self.half_hz, 0.0), self.centres_hz[-1] + self.half_hz

    @property
    def words(self) -> str:
        """The frequencies."""
        return listed([f"{one:.1f}" for one in self.centres_hz])


def campaign_figures(
    content: CampaignContent, before: Sequence[RecordView], after: Sequence[RecordView] | None
) -> CampaignFigures:
    """All figures of the page.

    Parameters
    ----------
    content : of the page.
    before, after : the records as the first and the last model explain them; records are paired by name.
    """
    with warnings.catch_warnings():
        # Text stays text in the page, so that a letter which matplotlib's own font lacks is no loss.
        warnings.filterwarnings("ignore", message="Glyph")
        return _figures(content, before, after)


def _figures(
    content: CampaignContent, before: Sequence[RecordView], after: Sequence[RecordView] | None
) -> CampaignFigures:
    usable = [view for view in before if view.measured_v.shape[0] >= 64 and view.residual.size][:_RECORDS]
    pairs = [(view, _same(view, after)) for view in usable]
    worst = _worst(pairs)
    groups = _resonances(content, usable)
    return CampaignFigures(
        ladder=_ladder(content),
        resonances=_drawn(
            (pair, f"around {group.words} Hz", _resonance(pair, group, f"resonance-{k}-{j}"))
            for k, pair in enumerate(worst[:2])
            for j, group in enumerate(groups)
        ),
        spectrograms=_drawn(
            (pair, "over time and frequency", _spectrogram(pair, f"spectrogram-{k}")) for k, pair in enumerate(worst)
        ),
        level=_level(pairs),
        channels=_channels(pairs),
    )


_Pair = tuple[RecordView, RecordView | None]


def _drawn(pictures: Iterable[tuple[_Pair, str, str]]) -> tuple[Picture, ...]:
    return tuple(
        Picture(pair[0].name, " (held out)" if pair[0].role == "validate" else "", what, svg)
        for pair, what, svg in pictures
        if svg
    )


def _same(view: RecordView, after: Sequence[RecordView] | None) -> RecordView | None:
    for other in after or ():
        if other.name == view.name and other.residual.shape == view.residual.shape:
            return other
    return None


def _worst(pairs: Sequence[_Pair]) -> list[_Pair]:
    """The worst fitted and the worst held-out record, then the worst of the others; repeats of a drive only once."""
    order = sorted(pairs, key=lambda pair: -pair[0].error)
    first = [next((p for p in order if p[0].role == role), None) for role in ("fit", "validate")]
    chosen = [pair for pair in first if pair is not None]
    for pair in order:
        alike = any(np.array_equal(pair[0].drive_v, other.drive_v) for other, _ in chosen)
        if not alike and len(chosen) < _PICTURED:
            chosen.append(pair)
    return chosen


def _ladder(content: CampaignContent) -> str:
    if len(content.rungs) + len(content.refused) < 2:
        return ""
    relative = not any(one.error_fit or one.error_validate for one in content.rungs)
    points = [
        LadderPoint(one.name, one.status, one.relative_error, None, None, None)
        if relative
        else LadderPoint(one.name, one.status, one.error_fit, one.error_validate, one.misfit_fit, one.misfit_validate)
        for one in content.rungs
    ]
    return ladder_plot(points, [effect_words(name) for name, _ in content.refused][:4], relative)


def _resonances(content: CampaignContent, views: Sequence[RecordView]) -> list[Window]:
    """Windows round the resonances of the fitted model, close ones together; round the strongest response without any."""
    if not views:
        return []
    values = {row.name: value.value for row in content.parameters if (value := row.after or row.before) is not None}
    known = sorted(
        (values[name], 20.0 * values.get(f"zeta{name[1:-3]}", 0.0) * values[name])
        for name in values
        if re.fullmatch(r"f\d*_hz", name) and values[name] > 0.0
    ) or _strongest(views)
    lines = _lines(views[0])
    groups: list[Window] = []
    for frequency, width in known:
        half = max(width, lines)
        if groups and frequency - groups[-1].centres_hz[-1] < half:
            last = groups.pop()
            groups.append(Window((*last.centres_hz, frequency), max(last.half_hz, half)))
        else:
            groups.append(Window((frequency,), half))
    nyquist = 0.5 * min(view.sample_rate_hz for view in views)
    return [group for group in groups if group.centres_hz[-1] < nyquist][:_RESONANCES]


def _strongest(views: Sequence[RecordView]) -> list[tuple[float, float]]:
    highest_drive_energy = max(views, key=lambda view: float(np.ptp(view.measured_v)))
    seen = spectra(highest_drive_energy, drive_band(highest_drive_energy))
    if not seen.frequency_hz.size:
        return []
    return [(float(seen.frequency_hz[int(np.argmax(seen.measured.max(axis=1)))]), 0.0)]


def _lines(view: RecordView) -> float:
    """Thirty lines of the record's Fourier transform [Hz]: a resonance that it can just resolve fills a few."""
    return 30.0 * view.sample_rate_hz / view.measured_v.shape[0]


def _titles(pair: _Pair) -> list[str]:
    """A model that stands alone needs no title."""
    return ["", ""] if pair[1] is None else ["before", "after"]


def _resonance(pair: _Pair, window: Window, name: str) -> str:
    panels = [
        ResonancePanel(title, spectra(view, window.band_hz), bool(later))
        for later, (view, title) in enumerate(zip(pair, _titles(pair)))
        if view is not None
    ]
    if not all(panel.spectra.frequency_hz.size > 1 for panel in panels):
        return ""
    return resonance_plot(panels, window.centres_hz, name)


def _spectrogram(pair: _Pair, name: str) -> str:
    views = [view for view in pair if view is not None]
    titles = _titles(pair)[: len(views)]
    nyquist = 0.5 * pair[0].sample_rate_hz
    low, high = drive_band(pair[0])
    room = max(0.2 * (high - low), _lines(pair[0]))
    near = (max(low - room, 0.0), min(high + room, nyquist))
    bands = [("full band, Hz", (0.0, nyquist), 120.0)]
    if near[1] - near[0] < 0.7 * nyquist:
        bands.append(("band of the drive, Hz", near, 30.0))
    rows = []
    for label, band, segments in bands:
        pictures = tuple(time_frequency(view, segments, band) for view in views)
        if all(picture.over_noise_db.size for picture in pictures):
            rows.append(SpectrogramRow(label, band, pictures))
    if not rows:
        return ""
    return spectrograms(rows, titles, *drive_frequency(pair[0]), name)


def _level(pairs: Sequence[_Pair]) -> str:
    curves = [
        LevelCurve(channel, view.role == "validate", bool(later), *by_level(view, channel))
        for pair in pairs
        for later, view in enumerate(pair)
        if view is not None
        for channel in range(view.senses)
    ]
    if not any(curve.level_v.size for curve in curves):
        return ""
    return level_plot(curves, pairs[0][0].senses)


def _channels(pairs: Sequence[_Pair]) -> str:
    rows = []
    for first, second in pairs:
        now = None if second is None else second.channel_errors()
        for channel, error in enumerate(first.channel_errors()):
            left = None if now is None else float(now[channel])
            rows.append(ChannelError(first.name, first.role, channel, float(error), left))
    return channel_errors(rows, pairs[0][0].senses) if rows else ""
