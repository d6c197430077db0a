"""The rows of a modal record: residues and poles, each in units of its sd.

    residues   (c_m - c_m(model)) / |c_m|_F                  Re and Im of every entry; c = i R1 + R0 / w
    poles      (p_m - p_m(model)) / (sqrt 2 |Re p_m|)        Re and Im

Both are in units of r, the unknown relative sd of the entries of a mode: an identification that finds residues to r finds the
pole to sqrt 2 r of a half-width (Cramer-Rao bound of a decaying exponential in white noise, one channel).  With a declared
``sd`` the noise is known: a residue is divided by its sd, a pole by sqrt 2 |Re p_m| rms(sd) / |c_m|_F.

Shapes: M modes, S senses, D drives; n = 2 M S D + 2 (modes of the plant) rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...criticism.problem import Candidate, FitResult, Region, Signatures, TermParameter
from ...experiment.files.modal_record import ModalRecord
from ...inference.modal.model import ResonantModes, measured_modes

#: sd of a pole in half-widths, relative to the relative sd of its residues.
POLE_WEIGHT = float(np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class ModalRows:
    """A modal record as rows.

    Parameters
    ----------
    record : poles and residues.
    pole_weight : sd of a pole in half-widths, relative to the relative sd of its residues; a small one fixes the poles.
    """

    record: ModalRecord
    pole_weight: float = POLE_WEIGHT

    @cached_property
    def measured(self) -> ResonantModes:
        """Poles [rad/s] and residues at resonance c (M, S, D) [1/s] of the record."""
        return measured_modes(self.record)

    @cached_property
    def norms(self) -> FloatArray:
        """(M,) Frobenius norm of c [1/s] of each mode."""
        norms: FloatArray = np.linalg.norm(self.measured.c, axis=(1, 2))
        return norms

    @cached_property
    def unit(self) -> FloatArray:
        """(M, 2, S, D) the unit of Im c and Re c [1/s]: the declared sd of R1 and R0/w, or the norm of the mode."""
        shape = (self.norms.size, 2, *self.record.R1.shape[1:])
        whole = np.broadcast_to(self.norms[:, None, None, None], shape)
        return whole if self.record.sd is None else self.record.sd

    @cached_property
    def relative_unit(self) -> FloatArray:
        """(M,) rms of ``unit`` over the entries of a mode, in units of its norm."""
        return np.asarray(np.sqrt(np.mean(self.unit**2, axis=(1, 2, 3))) / self.norms)

    @cached_property
    def pole_unit(self) -> FloatArray:
        """(M,) -pole_weight Re(p) ``relative_unit``, the unit of a pole [rad/s]."""
        return np.asarray(-self.pole_weight * self.measured.poles.real * self.relative_unit)

    def rows(self, modes: ResonantModes, present: BoolArray) -> FloatArray:
        """(n, 1): Im and Re of every residue, then Re and Im of the deviation of the poles, each in its unit.

        ``present`` (M,) selects the poles that the plant has.
        """
        poles = ((modes.poles - self.measured.poles) / self.pole_unit)[present]
        parts = (modes.c.imag / self.unit[:, 0], modes.c.real / self.unit[:, 1], poles.real, poles.imag)
        return np.concatenate([part.ravel() for part in parts])[:, None]

    def probes(self, rows: int) -> Signatures:
        """(n, K): any change of the residues, mode by mode and of all modes together; ``rows`` is n."""
        entries = self.measured.c.size
        mode = np.repeat(np.arange(self.norms.size), entries // self.norms.size)
        groups = {f"mode {m + 1}": np.flatnonzero(np.tile(mode, 2) == m) for m in range(self.norms.size)}
        groups["all modes"] = np.arange(2 * entries)
        candidates, columns, first = [], [], 0
        for name, own in groups.items():
            parameters = tuple(TermParameter(f"{name} {i}") for i in own)
            candidates.append(Candidate(name, parameters, (slice(first, first + own.size),)))
            columns.append(np.eye(rows)[:, own])
            first += own.size
        return Signatures(tuple(candidates), (np.concatenate(columns, axis=1),))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """The residual energy of each of the M S D entries; two rows less their share of the fitted parameters."""
        entries = self.measured.c.size
        residuals = fit.blocks[0].rows[: 2 * entries].reshape(2, *self.measured.c.shape)
        energy = np.sum(residuals**2, axis=0)
        dof_per_row = fit.dof / max(fit.rows, 1)
        return [
            Region("resonance", self._labels(entry), float(energy[entry]), 2.0 * dof_per_row)
            for entry in np.ndindex(energy.shape)
        ]

    def _labels(self, entry: tuple[int, ...]) -> dict[str, object]:
        mode, sense, drive = entry
        f, zeta = float(self.record.frequency_hz[mode]), float(self.record.zeta[mode])
        return {
            "record": self.record.name,
            "mode": mode + 1,
            "channel": f"sense{sense + 1}",
            "drive": f"drive{drive + 1}",
            "band_hz": [f * (1.0 - zeta), f * (1.0 + zeta)],
        }
