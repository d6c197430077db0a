"""The false alarms that the learning code may make, and the SNRs that follow from them: one place for every test.

a name            P(a term is named | none is present)      = ALPHA,        over all candidates of one step
a region; repeats that are called different                 = ALPHA,        over all regions; over all pairs
a structure left  P(noise is called structured: "unknown")  = ALPHA,        over all tests of the residual
detectable        z(ALPHA / 2 / 20 terms) + z(0.1) = 3.8 + 1.3 = 5 sigma: found nine times in ten
clear             5 sigma + z(ALPHA / 2) = 8 sigma: no other support is needed, because a size that is wrong by as much as noise
                  makes it at ALPHA still is detectable
draws             so many that ``COUNTED`` of a simulated null fall below ALPHA: p is known to 1 / sqrt(COUNTED) of itself there
"""

from __future__ import annotations

from scipy.special import ndtri

ALPHA = 0.003
DETECTABLE_SNR = 5.0
CLEAR_SNR = DETECTABLE_SNR - float(ndtri(ALPHA / 2.0))
COUNTED = 60
DRAWS = round(COUNTED / ALPHA)
