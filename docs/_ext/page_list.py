"""The directive `pages`: the pages of a section, each with its title and its first sentence.

```{pages} how-to
```
"""

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.docutils import SphinxDirective


class Pages(nodes.General, nodes.Element):
    """Where the list goes; ``folder`` names the section."""


class PagesDirective(SphinxDirective):
    """Reads the name of the folder, and the pages that are left out."""

    required_arguments = 1
    optional_arguments = 20

    def run(self) -> list[nodes.Node]:
        """A place that the transform fills once all pages are read."""
        return [Pages("", folder=self.arguments[0], without=self.arguments[1:])]


class FillPages(SphinxPostTransform):
    """Writes the list of a section."""

    default_priority = 300

    def run(self, **_: Any) -> None:
        """Replace the places of one page."""
        for place in list(self.document.findall(Pages)):
            place.replace_self(self._list(place["folder"], place["without"]))

    def _list(self, folder: str, without: list[str]) -> nodes.Element:
        names = [name for name in self.env.found_docs if name.rpartition("/")[0] == folder]
        left_out = {f"{folder}/{name}" for name in (*without, "index")}
        entries = [(self.env.titles[name].astext(), name) for name in names if name not in left_out]
        listed = nodes.definition_list(classes=["pages"])
        for title, name in sorted(entries, key=lambda entry: entry[0].lower()):
            uri = self.env.app.builder.get_relative_uri(self.env.docname, name)
            link = nodes.reference("", title, internal=True, refuri=uri)
            about = nodes.definition("", nodes.paragraph("", _first_sentence(self.env.get_doctree(name))))
            listed += nodes.definition_list_item("", nodes.term("", "", link), about)
        return listed


def _first_sentence(page: nodes.document) -> str:
    paragraphs = (node for node in page.findall(nodes.paragraph) if isinstance(node.parent, nodes.section))
    text = " ".join(next((node.astext() for node in paragraphs), "").split())
    # An initial or an abbreviated journal ends no sentence.
    return re.split(r"(?<=[.:])(?<!\b[A-Z]\.)\s+(?=[A-Z`])", text)[0]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register directive and transform."""
    app.add_node(Pages)
    app.add_directive("pages", PagesDirective)
    app.add_post_transform(FillPages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
