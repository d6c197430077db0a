"""The page of a night in Chromium: a dragged or typed limit gives the yield of the command, by mouse and by keyboard."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from workflows.cli import call

from .conftest import Visit, served
from .night_page import DEVICE, END, TEXTS, Dragged

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from reports.words.explore import AS_STORED, EXACT, PREVIEW
from workflows.explore.night import view

#: Records whether each new text of the yield is marked as a preview.
WATCH = """(words) => {
  const total = Bokeh.documents[0].get_model_by_name("yield");
  window.previews = [];
  total.properties.text.change.connect(() => window.previews.push(total.text.includes(words)));
}"""
#: Label of the element that has the focus.
FOCUSED = """() => {
  let one = document.activeElement;
  while (one && one.shadowRoot && one.shadowRoot.activeElement) one = one.shadowRoot.activeElement;
  const label = one && one.labels && one.labels.length ? one.labels[0] : one;
  return label ? label.innerText : "";
}"""
#: Fields without a name that can be seen.
NAMELESS = """() => {
  const found = [];
  const walk = (node) => {
    if (["INPUT", "SELECT", "BUTTON"].includes(node.tagName) && node.offsetParent) {
      const label = node.labels && node.labels.length ? node.labels[0].innerText : node.innerText;
      if (!label.trim()) found.push(node.outerHTML);
    }
    for (const one of [...(node.shadowRoot ? node.shadowRoot.children : []), ...(node.children || [])]) walk(one);
  };
  walk(document.body);
  return found;
}"""


@pytest.fixture(scope="module")
def address(night: Path) -> Iterator[str]:
    with served(view(night)) as found:
        yield found


def shown(visit: Visit, name: str = "yield") -> str:
    """The text of the only element of a class."""
    (text,) = visit.page.evaluate(TEXTS, name)
    return str(text).replace("\u00a0", " ")


def file_of(visit: Visit) -> str:
    """The limits as the page states them."""
    return str(visit.page.evaluate('Bokeh.documents[0].get_model_by_name("file").text'))


def files_of(night: Path) -> dict[str, Any]:
    """Names, times and contents of all files of the run."""
    found = [path for path in night.parent.rglob("*") if path.is_file()]
    return {str(path): (path.stat().st_mtime_ns, path.read_bytes()) for path in found}


def tabbed(visit: Visit, wanted: str) -> list[str]:
    """Press Tab until the field ``wanted`` has the focus; the names of all fields on the way."""
    order: list[str] = []
    while wanted not in order:
        visit.page.keyboard.press("Tab")
        order.append(str(visit.page.evaluate(FOCUSED)).strip())
        assert len(order) < 60, order
    return order


def drag(visit: Visit, end: int, pixels: float) -> None:
    """Drag a line of the limit, in steps."""
    line = Dragged(**visit.page.evaluate(END, end))
    visit.page.mouse.move(line.x, line.y)
    visit.page.mouse.down()
    visit.page.mouse.move(line.x + pixels, line.y, steps=8)
    visit.page.mouse.up()


def wait_for(visit: Visit, state: str) -> None:
    """Wait until the yield is marked as ``state``."""
    for _ in range(600):
        if shown(visit, "state") == state:
            return
        visit.page.wait_for_timeout(50)
    raise AssertionError(f"the yield is {shown(visit, 'state')!r}, never {state!r}")


def command_says(night: Path, text: str, folder: Path, capsys: Any) -> dict[str, Any]:
    """What ``gyroscreen report --limits`` answers for the limits in ``text``."""
    path = folder / "new.toml"
    path.write_text(text, encoding="utf-8")
    page = str(folder / "page.html")
    capsys.readouterr()
    assert call(["report", "--results", str(night.parent), "--limits", str(path), "--json", "--out", page]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found["yield"]


def check_yield(visit: Visit, night: Path, folder: Path, capsys: Any) -> dict[str, Any]:
    """The page shows the yield, the interval and the counts of the command."""
    says = command_says(night, file_of(visit), folder, capsys)["new"]
    assert shown(visit) == f"{100 * says['yield']:.1f} %"
    page = visit.page.inner_text("body") + " ".join(visit.page.evaluate(TEXTS, "total"))
    text = page.replace("\u00a0", " ")
    assert f"{100 * says['low']:.1f} to {100 * says['high']:.1f} %" in text
    assert f"{says['pass']} of {says['devices']} devices pass" in text
    return says


def test_a_dragged_limit_gives_the_yield_of_the_command(
    address: str, night: Path, visit: Callable[..., Visit], tmp_path: Path, capsys: Any
) -> None:
    before = files_of(night)
    page = visit(address)
    assert shown(page, "state") == AS_STORED
    assert page.widest() <= 0
    first, line = shown(page), Dragged(**page.page.evaluate(END, 1))
    page.page.evaluate(WATCH, PREVIEW)
    drag(page, 1, -150)
    wait_for(page, EXACT)
    previews = page.page.evaluate("window.previews")
    # While it moves, the yield is marked as a preview; at rest it is the judgement.
    assert (previews[0], previews[-1]) == (True, False)
    assert shown(page) != first
    says = check_yield(page, night, tmp_path, capsys)
    assert 0 < says["pass"] < says["devices"]
    # The limit is where the mouse left the line.
    high = float(re.search(r"\[limits.f1_hz\]\s+min = \S+\s+max = (\S+)", file_of(page)).group(1))  # type: ignore[union-attr]
    assert high == pytest.approx(line.value - 150 * line.per_px, abs=2 * abs(line.per_px))
    assert page.complaints == []
    assert page.foreign() == []
    assert files_of(night) == before


def test_the_keyboard_alone_moves_a_limit_and_finds_a_device(
    address: str, night: Path, visit: Callable[..., Visit], tmp_path: Path, capsys: Any
) -> None:
    page = visit(address)
    assert page.page.evaluate(NAMELESS) == []
    assert page.page.locator("main section[aria-label]").count() == 6
    keyboard = page.page.keyboard
    order = tabbed(page, "max")
    assert [name for name in order if name in ("Quantity", "min", "max")] == ["Quantity", "min", "max"]
    for _ in range(12):
        keyboard.press("ArrowDown")
    wait_for(page, EXACT)
    check_yield(page, night, tmp_path, capsys)
    tabbed(page, "Device")
    keyboard.type("D000003")
    keyboard.press("Enter")
    page.until(f"({TEXTS})('verdict').some((one) => one.startsWith('D000003'))")
    assert page.complaints == []


def test_a_device_that_is_clicked_shows_its_verdict_and_its_residual(address: str, visit: Callable[..., Visit]) -> None:
    page = visit(address, height=1600)
    place = page.page.evaluate(DEVICE, 5)
    page.page.mouse.click(place["x"], place["y"])
    page.until(f"({TEXTS})('verdict').some((one) => one.startsWith({json.dumps(place['name'])}))")
    page.until('Bokeh.documents[0].get_model_by_name("Spectrum").visible')
    page.settle()
    assert shown(page, "residual").startswith("Record chirp, simulated again from its seed")
    error = float(shown(page, "residual").split("error ")[1].split(" ")[0])
    assert error == pytest.approx(1.0, abs=0.1)
    selected = 'Bokeh.documents[0].get_model_by_name("Two quantities").renderers[0].data_source.selected.indices'
    assert page.page.evaluate(selected) == [5]
    # A refused limit is said, and changes nothing.
    first, field = shown(page), page.page.get_by_label("min", exact=True)
    field.fill("9000")
    field.press("Enter")
    page.until(f"({TEXTS})('refused').some((one) => one.includes('crossed'))")
    assert shown(page) == first
    assert page.complaints == []


def test_a_narrow_dark_window_does_not_scroll_sideways(address: str, visit: Callable[..., Visit]) -> None:
    page = visit(address, width=400, height=800, dark=True)
    # The table of a device and its figures are the widest parts.
    page.page.get_by_role("textbox", name="Device").fill("D000003")
    page.page.keyboard.press("Enter")
    page.until('Bokeh.documents[0].get_model_by_name("Spectrum").visible')
    page.settle()
    for width in (400, 760):
        page.page.set_viewport_size({"width": width, "height": 800})
        page.page.wait_for_timeout(200)
        assert page.widest() <= 0
    assert page.page.evaluate("getComputedStyle(document.documentElement).backgroundColor") != "rgb(255, 255, 255)"
    assert page.complaints == []
