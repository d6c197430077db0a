"""Single frequencies that rise out of their neighbourhood in a spectrum.

    beyond_k = chi2_k / max(1, median over the neighbours of chi2 / median of chi2_d),    ~ chi2_d where only noise is left

Noise that is coloured or stronger than its level says lifts the neighbours as well; a line does not.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from ..arrays import FloatArray
from .problem import Spectrum

_NEIGHBOURS = 101


def beyond_neighbours(spectrum: Spectrum) -> FloatArray:
    """Energies (M,), each in units of its neighbourhood's level where that lies above the noise level."""
    size = min(_NEIGHBOURS, spectrum.chi2.size)
    level = median_filter(spectrum.chi2, size=size, mode="reflect") / chdtri(spectrum.dof, 0.5)
    return np.asarray(spectrum.chi2 / np.maximum(level, 1.0))
