"""The what-if page: complete, self-contained, escaped, and the same for the same content."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from markup import PAYLOADS, added

from reports.coded import coded
from reports.what_if.content import WhatIf
from reports.what_if.page import render_what_if
from reports.words.what_if import what_if_lines
from tests.reports.what_if.test_judge import _content


@pytest.fixture(scope="module")
def content() -> WhatIf:
    return _content()


def test_every_section_and_figure_is_there(content: WhatIf) -> None:
    page = render_what_if(content)
    for name in ("limits", "yield", "risks", "changed", "curves", "pairs"):
        assert page.count(f'id="{name}"') == 1
        assert page.count(f'href="#{name}"') == 1
    assert page.count("<svg") == 2
    assert "new.toml" in page
    assert render_what_if(content) == page
    assert not re.search(r'(?:src|href)="(?!#)', page)


def test_markup_in_names_is_escaped(content: WhatIf) -> None:
    harmless = render_what_if(replace(content, run_id="x", limits_name="x"))
    for payload in PAYLOADS[::7]:
        device = replace(content.changed[0], device_id=payload, lot=payload, wafer=payload)
        page = render_what_if(replace(content, run_id=payload, limits_name=payload, changed=(device,)))
        assert not added(page, harmless)


def test_a_content_without_changes_has_a_page(content: WhatIf) -> None:
    page = render_what_if(
        replace(content, changed=(), changes=(), pairs=(), curves=(), wafers=(), lots=(), risks_new=())
    )
    assert "No device changes its verdict." in page
    assert 'id="changed"' not in page


def test_the_terminal_says_the_same(content: WhatIf) -> None:
    lines = what_if_lines(content)
    assert lines[0].startswith("old limits: yield ")
    assert lines[1].startswith("new limits: yield ")
    assert any("costliest pair" in line for line in lines)
    assert any("40 stored draws" in line for line in lines)
    assert coded(lines)
