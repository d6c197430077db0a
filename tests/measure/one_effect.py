"""What ``refine`` says about single library effects of an SNR near 100 on the standard hidden campaign.

    python tests/measure/one_effect.py EFFECT[:NUMBER] ..

The NUMBER (by default 0) counts the campaigns of one effect; each is drawn anew.
"""

from __future__ import annotations

import sys
from dataclasses import replace

from workflows.studies.hidden import draw, study
from workflows.studies.hidden.confusion import answer
from workflows.studies.hidden.effects import LIBRARY

if __name__ == "__main__":
    draw.KINDS["one"] = replace(draw.KINDS["one"], snr=(95.0, 105.0))
    for name, _, number in (word.partition(":") for word in sys.argv[1:]):
        hidden = draw.hide("one", LIBRARY.index(name) + int(number or 0) * len(LIBRARY), 2026)
        row = study.examine(hidden)
        found = row["refine"]
        print(
            f"{name} SNR {hidden.snr[0]:.0f}: {answer(row, 'refine')}: {found['verdict']}, {', '.join(found['effects'])}; "
            f"classes {found['classes']}; {found['cpu_seconds']:.0f} s",
            flush=True,
        )
