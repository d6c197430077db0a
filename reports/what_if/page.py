"""The what-if page: one self-contained HTML file that opens offline.

WhatIf --figures, template--> HTML
"""

from __future__ import annotations

from ..devices import wafer_name
from ..html.rendering import environment, stylesheet
from ..words.capability import share_words
from ..words.what_if import by_words, difference_sentence, headline, thinning_sentences
from .content import WhatIf
from .figures import curve_panels, pair_bars

MOST_DEVICES = 60
MOST_GROUPS = 60


def render_what_if(content: WhatIf) -> str:
    """The page as HTML text; the same content gives the same page."""
    return (
        environment()
        .get_template("what_if.html.j2")
        .render(
            c=content,
            stylesheet=stylesheet(),
            headline=headline(content),
            difference=difference_sentence(content),
            thinning=thinning_sentences(content),
            figures={
                "curves": curve_panels(content.curves),
                "pairs": pair_bars(content.pairs, content.total.new.devices),
            },
            by_words=by_words,
            share=share_words,
            wafer_name=wafer_name,
            most_devices=MOST_DEVICES,
            most_groups=MOST_GROUPS,
            limit_rows=limit_rows(content),
        )
    )


def limit_rows(content: WhatIf) -> tuple[tuple[str, object, object], ...]:
    """(quantity, old limit, new limit) of every limited quantity; ``None`` where there is no limit."""
    old, new = ({limit.quantity: limit for limit in one.limits} for one in (content.old, content.new))
    return tuple((name, old.get(name), new.get(name)) for name in dict.fromkeys((*new, *old)))
