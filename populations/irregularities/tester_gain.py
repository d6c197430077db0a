"""Channel gains of the wafer prober: they affect measurements of the bare die, not of the packaged device.

    ln K_k += s n_k, the same for all devices

K_k is the gain of channel k, s is ``channel_pct``, and the standard normal numbers n_k are the same for all devices of a run.

Source: contact and amplifier tolerances (assumed).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_channel (4, B) [1] of D1, D2, S1, S2."""
    channels = 0.01 * p["channel_pct"] * site.fixed(4)
    return Change(ln_channel=np.repeat(channels[:, None], len(site.index), axis=1))


IRREGULARITY = Irregularity(
    name="tester_gain",
    stage="probe",
    parameters=(IrregularityParameter("channel_pct", "%", 0.0, 30.0, "sd of the gain of a channel of the prober"),),
    source="assumed",
    act=act,
    latex=r"\Delta \ln K_k = s\,n_k",
)
