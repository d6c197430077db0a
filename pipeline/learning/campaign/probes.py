"""Generic shapes in the rows of a campaign, which almost any missing effect resembles; they are tested and never named.

Shapes: N samples, S senses, F bins, K columns of all families; the rows of a record are 2 F S.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...criticism.problem import Candidate, Signatures, TermParameter
from ...experiment.forward.drive_groups import DriveGroup
from ...experiment.forward.generic_forces import read_out, record_motion, responses
from ...experiment.forward.response import Starts, response_sources
from ...experiment.forward.system import System
from ...experiment.record import Record
from ...inference.general.fit import CampaignFit
from ...inference.general.residuals import CampaignResiduals
from .generic_shapes import drive_families, force_families, volt_families
from .rows import FourierRows, white_rows


def probe_signatures(
    problem: CampaignResiduals, fitted: CampaignFit, records: Sequence[Record], spectra: Sequence[FourierRows]
) -> Signatures:
    """Columns (2 F S, K) of generic shapes, whitened, one candidate for each family; its amplitudes are common to all records."""
    tasks = problem.tasks(records, fitted.values)
    known = {r.name: r for r in fitted.records}
    blocks = [np.zeros((0, 0))] * len(records)
    families: dict[str, int] = {}
    for places, group in tasks.groups:
        system = problem.system(fitted.values, group)
        starts = [known[records[place].name].start for place in places]
        for k, (place, source) in enumerate(zip(places, response_sources(group, starts))):
            if source != k:
                blocks[place] = blocks[places[source]]
                continue
            record = records[place]
            found = _predicted_shapes(known[record.name].predicted_v, record.sample_rate_hz)
            found |= _shapes(system, group, k, starts)
            families = {name: columns.shape[0] for name, columns in found.items()}
            rows = np.empty((sum(families.values()), 2 * spectra[place].bins.size * record.sense_v.shape[1]))
            # One family at a time: whitening and transform need a copy of what they take.
            first = 0
            for columns in found.values():
                rows[first : first + columns.shape[0]] = white_rows(problem, tasks.each[place], spectra[place], columns)
                first += columns.shape[0]
            blocks[place] = rows.T
    edges = np.cumsum([0, *families.values()]).tolist()
    return Signatures(
        tuple(
            Candidate(name, (TermParameter("amplitude"),) * width, (slice(first, first + width),))
            for (name, width), first in zip(families.items(), edges)
        ),
        tuple(blocks),
    )


def _shapes(system: System, group: DriveGroup, record: int, starts: Starts) -> dict[str, FloatArray]:
    """Columns (k, N, S) [V] of each family of forces and volts; without a drive, those that follow it are absent."""
    motion, hold = record_motion(system, group, record, starts), group.clock.hold
    found = {name: responses(system, group, own) for name, own in force_families(motion).items()}
    found |= {name: responses(system, group, own, hold) for name, own in drive_families(motion).items() if own}
    return found | {name: read_out(system, group, own) for name, own in volt_families(motion).items() if own}


def _predicted_shapes(y: FloatArray, sample_rate_hz: float) -> dict[str, FloatArray]:
    """Powers, drifts, slopes and crosstalk (1, N, S) of the predicted record (N, S) [V], each in each channel separately."""
    t = np.arange(y.shape[0])[:, None] / sample_rate_hz
    slope = np.gradient(y, axis=0)
    shapes = [y * t, y**2, y**3, np.abs(y) * y, y**2 * slope, slope, slope * t, y[:, ::-1], np.sign(y)]
    channels = np.eye(y.shape[1])
    return {
        f"shape {i} in channel {s + 1}": (shape * channels[s])[None]
        for i, shape in enumerate(shapes)
        for s in range(y.shape[1])
    }
