"""The manual: generated pages state everything that the code reads and writes, the strict build passes, and it works offline."""

import inspect
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import fields, is_dataclass
from functools import cached_property
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import msgspec
import numpy as np
import pytest
import typer
from latex2mathml.converter import convert

from pipeline.device.effect import find_effects
from pipeline.errors import NegativeError, UsageError
from pipeline.learning.lot.generic import generic_irregularities
from pipeline.quantities import QUANTITIES
from pipeline.store.irregularity_table import IRREGULARITIES
from pipeline.store.schema import COLUMNS
from pipeline.toml_keys import meanings
from populations.irregularity import CHANGES, find
from workflows import api
from workflows.cli import app
from workflows.manual.build import build
from workflows.manual.irregularities import CHANGED
from workflows.manual.keys import FILES, tables_of
from workflows.manual.laws import law_as_latex
from workflows.manual.markdown import plain
from workflows.manual.pages import generated_pages
from workflows.manual.python import public_classes, public_functions
from workflows.manual.signatures import SIGMA_V, SNR, alike, effect_signature
from workflows.manual.sources import ManualSources, built_folder, find_sources

ROOT = Path(__file__).parents[3]
COMMANDS = typer.main.get_command(app)


@pytest.fixture(scope="module")
def pages():
    return generated_pages(COMMANDS)


@pytest.fixture(scope="module")
def site(pages, tmp_path_factory):
    """The manual, built strictly; its notebooks are executed by their own tests."""
    out = tmp_path_factory.mktemp("manual") / "site"
    build(find_sources(), pages, out, strict=True, notebooks=False)
    return out


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.page)
def test_every_key_of_every_file_has_a_meaning_and_a_number_has_a_unit(file, pages):
    page = pages[f"reference/files/{file.page}.md"]
    for one in tables_of(file.kind):
        known = meanings(one.kind)
        for field in msgspec.structs.fields(one.kind):
            meaning = known[field.name]
            where = f"{file.page} {one.header} {field.name}"
            assert meaning.text, f"{where} has no meaning: Annotated[.., Meaning(..)] where it is declared"
            if holds_numbers(field.type):
                assert meaning.unit, f'{where} has no unit: Meaning("..", "1") for counts and ratios'
            assert f"| `{field.encode_name}` |" in page, where


def holds_numbers(kind):
    """Whether a msgspec type holds numbers that are no codes."""
    text = str(msgspec.json.schema(kind))
    return ("'type': 'number'" in text or "'type': 'integer'" in text) and "$ref" not in text


def test_a_key_that_two_tables_share_takes_its_meaning_from_the_first():
    from workflows.config_bench import RunAntiAliasTable

    assert meanings(RunAntiAliasTable)["corner_hz"].text == "frequency of -3 dB"
    assert meanings(RunAntiAliasTable)["corner_hz"].unit == "Hz"


def test_every_column_of_every_table_is_described(pages):
    page = pages["reference/columns.md"]
    quantities = {quantity.name for quantity in QUANTITIES}
    for column in (*COLUMNS, *IRREGULARITIES):
        name = re.sub(r"^(true|fab)_|_(sd|q05|q95|bias_bound)$", "", column.name)
        assert f"| `{name if name in quantities else column.name}` |" in page, column.name


def test_every_command_and_option_is_described(pages):
    page = pages["reference/commands.md"]

    def walk(name, command):
        for sub, inner in getattr(command, "commands", {}).items():
            walk(f"{name} {sub}", inner)
        if not hasattr(command, "commands"):
            section = page.split(f"\n## {name}\n")[1].split("\n## ")[0]
            for one in command.params:
                if not {"--help", "--debug"} & set(one.opts):
                    named = one.opts[0] if one.opts[0].startswith("-") else str(one.name).upper()
                    assert named in section, f"{name} {named}"

    walk("gyroscreen", COMMANDS)


def test_every_public_name_of_the_interface_is_documented(pages):
    page = pages["reference/python.md"]
    functions = [getattr(api, name) for name in api.__all__ if inspect.isfunction(getattr(api, name))]
    for found in (*functions, *public_functions(api.figures), *public_classes()):
        assert f"{found.__module__}.{found.__qualname__}" in page
        assert found.__doc__, found
    named = {kind.__name__ for kind in public_classes()}
    assert {"ScreeningRun", "IdentifiedDevice", "ComparisonResult", "RefinementResult", "Model", "Limits"} <= named
    for kind in public_classes():
        own = {field.name for field in fields(kind)} if is_dataclass(kind) else set()
        for name, value in inspect.getmembers(kind):
            if name.startswith("_") or (
                not isinstance(value, property | cached_property) and not inspect.isfunction(value)
            ):
                continue
            assert name in own or inspect.getdoc(value), f"{kind.__name__}.{name} has no docstring"


def test_every_effect_has_a_page_with_its_equation_parameters_picture_and_source(pages):
    for name, effect in find_effects().items():
        page = pages[f"reference/effects/{name}.md"]
        convert(effect.latex)
        assert effect.latex in page
        assert all(f"`{parameter.quantity or f'{name}.{parameter.name}'}`" in page for parameter in effect.parameters)
        assert "Source: " in page
        for like in effect.look_alikes:
            assert all(f"({other}.md)" in page for other in like.effects)
            assert all(f"({name}.md)" in pages[f"reference/effects/{other}.md"] for other in like.effects)
        ElementTree.fromstring(pages[f"reference/effects/{name}.svg"])


def test_the_size_in_a_picture_has_the_stated_snr_and_a_fit_of_the_plant_leaves_less():
    library = find_effects()
    cubic = effect_signature(library["cubic_stiffness"])
    assert np.linalg.norm(cubic.change) / SIGMA_V == pytest.approx(SNR, rel=0.05)
    assert 0.0 < np.linalg.norm(cubic.left) < np.linalg.norm(cubic.change)
    mode = effect_signature(library["parasitic_mode"])
    assert np.linalg.norm(mode.change) / SIGMA_V == pytest.approx(SNR, rel=1e-6)
    # In one chirp, a delay is a pole to first order; a stiffness is neither.
    delay, pole = (effect_signature(library[name]) for name in ("loop_delay", "pickoff_pole"))
    assert alike(delay, pole) > 0.999
    assert alike(delay, cubic) < 0.5


def test_the_index_of_effects_names_pairs_that_one_chirp_cannot_tell_apart(pages):
    index = pages["reference/effects/index.md"]
    assert "| `loop_delay` | `pickoff_pole` | 1.000 |" in index
    assert "| [`pickoff_pole`](pickoff_pole.md) | `loop_delay` | at every size |" in index


def test_every_irregularity_has_a_page_with_its_equation_parameters_and_picture(pages):
    for name, one in find().items():
        page = pages[f"reference/irregularities/{name}.md"]
        convert(one.latex)
        assert f"$$\n{one.latex}\n$$" in page
        assert all(f"| `{parameter.name}` |" in page for parameter in one.parameters)
        assert "Source: " in page
        assert "## Look-alikes" in page
        ElementTree.fromstring(pages[f"reference/irregularities/{name}.svg"])
    # Width and thickness act on the same stiffness; the split of an anisotropy has its own direction.
    assert "| `spring_width.lot` | `spring_thickness.lot` |" in pages["reference/irregularities/spring_width.md"]
    assert "No random part" in pages["reference/irregularities/lid_leak.md"]
    # What it changes is found by drawing a device, not declared a second time.
    tilt, stress = (pages[f"reference/irregularities/{name}.md"] for name in ("sidewall_tilt", "die_attach_stress"))
    assert "It changes the anisotropy $e$" in tilt
    assert "It changes the stiffness of all springs, $\\ln k$; the anisotropy $e$" in stress
    assert set(CHANGED) == set(CHANGES)
    for name, one in generic_irregularities().items():
        page = pages[f"reference/irregularities/generic-{name}.md"]
        assert ("## Equation" in page) == (not one.probe), name
        ElementTree.fromstring(pages[f"reference/irregularities/generic-{name}.svg"])


def test_laws_of_generic_irregularities_become_formulas():
    assert law_as_latex("A gradient: y += s (n1 x + n2 y), x and y in wafer radii.") == (
        "A gradient. The coordinates x and y are in wafer radii.",
        r"\Delta q = s\,(n_1\,x + n_2\,y)",
    )
    assert law_as_latex("Two: y_j += s_j n(device), y_k += +-s_k n(device).")[1] == (
        r"\Delta q_j = s_j\,n_\text{device}, \Delta q_k = \pm\,s_k\,n_\text{device}"
    )
    assert law_as_latex("Probe: a field on each wafer.  Never named.")[1] == ""


def test_symbols_in_sentences_are_set_as_in_print_and_names_are_not():
    assert plain("psi_x^2 over 2 um") == "ψ<sub>x</sub><sup>2</sup> over 2 µm"
    assert plain("V_b (1 + gamma t)") == "V<sub>b</sub> (1 + γ t)"
    for name in ("sense_imbalance", "f1_hz", "deltas", "cubic_stiffness.k3"):
        assert plain(name) == name.replace("_", "\\_")
    assert plain("``psi_x``") == "`psi_x`"


class References(HTMLParser):
    """Addresses that a page loads, addresses that it links to, and its anchors."""

    def __init__(self, text):
        super().__init__()
        self.loaded, self.linked, self.anchors, self.formulas = [], [], set(), 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found[key] for key in ("id", "name") if found.get(key)}
        self.formulas += tag == "math"
        if tag == "a" and found.get("href"):
            self.linked.append(found["href"])
        elif (
            tag == "link"
            and found.get("href")
            and found.get("rel") not in ("canonical", "next", "prev", "search", "index")
        ):
            self.loaded.append(found["href"])
        elif tag not in ("a", "link"):
            self.loaded += [found[key] for key in ("src", "data", "poster", "action") if found.get(key)]
            self.loaded += [part.split()[0] for part in (found.get("srcset") or "").split(",") if part.strip()]


@pytest.fixture(scope="module")
def references(site):
    pages = (page for page in site.rglob("*.html") if "_static" not in page.parts)
    return {page: References(page.read_text(encoding="utf-8")) for page in pages}


def test_no_page_loads_anything_from_another_host(site, references):
    assert len(references) > 100
    for page, found in references.items():
        for address in found.loaded:
            parts = urlsplit(address)
            assert parts.scheme in ("", "data"), f"{page}: {address}"
            assert not parts.netloc, f"{page}: {address}"
            if not parts.scheme and parts.path:
                assert (page.parent / unquote(parts.path)).exists(), f"{page}: {address}"
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(url\(|@import)\s*[\"']?\s*(https?:)?//", text), sheet


def test_every_internal_link_and_anchor_exists(references):
    anchors = {page.resolve(): found.anchors for page, found in references.items()}
    for page, found in references.items():
        for address in found.linked:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page.resolve()
            target = target / "index.html" if target.is_dir() else target
            assert target.exists(), f"{page}: {address}"
            if parts.fragment and target.suffix == ".html":
                assert unquote(parts.fragment) in anchors[target], f"{page}: {address}"


def test_formulas_are_mathml_and_need_no_script(site, references):
    assert references[site / "reference" / "effects" / "cubic_stiffness.html"].formulas == 1
    for page in references:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<script[^>]*(mathjax|katex)", text, re.IGNORECASE), page


def test_the_ten_questions_have_pages(site):
    text = (site / "index.html").read_text(encoding="utf-8")
    questions = text.split('id="which-page-answers-my-question"')[1].split("</section>")[0]
    rows = re.findall(r"<tr.*?</tr>", questions, re.DOTALL)[1:]
    assert len(rows) == 10
    assert all('href="' in row for row in rows)


def test_the_search_index_is_a_local_script_that_knows_the_keys(site):
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    assert index.startswith("Search.setIndex(")
    for word in ("campaign", "theta", "bandlimit", "parasitic_mod"):
        assert word in index, word


def small(folder: Path, text: str) -> ManualSources:
    """Sources with one page."""
    real = find_sources()
    for path in real.files:
        name = path.relative_to(real.root)
        if name.parts[:2] in (("docs", "_ext"), ("docs", "_static"), ("docs", "conf.py")) or len(name.parts) == 1:
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
    (folder / "docs" / "index.md").write_text(text, encoding="utf-8")
    return ManualSources(folder, real.packages)


def test_a_broken_link_a_page_that_does_not_exist_and_a_wrong_formula_fail_the_strict_build(tmp_path):
    text = "# Page\n\n[broken](nowhere.md) `docs/how-to/nothing.md` {doc}`absent` $\\frac{1$\n"
    with pytest.raises(NegativeError, match="manual was not built") as caught:
        build(small(tmp_path / "root", text), {}, tmp_path / "site", strict=True, notebooks=False)
    for fault in ("nowhere.md", "docs/how-to/nothing.md", "absent"):
        assert fault in str(caught.value)
    assert not (tmp_path / "site").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["root"]


def test_a_folder_that_holds_something_else_is_not_replaced(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="something else"):
        build(find_sources(), {}, tmp_path)
    assert (tmp_path / "mine.txt").exists()


def test_the_built_folder_depends_on_every_source(tmp_path):
    sources = small(tmp_path, "# Page\n")
    before = built_folder(sources)
    assert before == built_folder(sources)
    (tmp_path / "docs" / "index.md").write_text("# Another\n", encoding="utf-8")
    assert built_folder(sources) != before
    assert not built_folder(sources).is_relative_to(sources.packages)


def test_the_wheel_holds_every_source_of_the_manual():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    shipped = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    for path in find_sources().files:
        name = path.relative_to(ROOT).as_posix()
        top = name.split("/")[0]
        assert shipped[top] == f"workflows/manual/sources/{top}", name
