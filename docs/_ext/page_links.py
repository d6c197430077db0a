"""Names of pages in code, such as `docs/how-to/lots.md`, become links; the sources stay readable as they are.

A name of a page that does not exist is a fault, as a broken link is.
"""

import posixpath
import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging

log = logging.getLogger(__name__)
_PAGE = re.compile(r"(?:\.\./)*docs/([\w/-]+)\.md(#[\w-]+)?$")


class PageLinks(SphinxPostTransform):
    """Literal text that names a page of the manual becomes a link to it."""

    default_priority = 400

    def run(self, **_: Any) -> None:
        """Replace the literals of one page."""
        for node in list(self.document.findall(nodes.literal)):
            match = _PAGE.match(node.astext())
            if match is None or isinstance(node.parent, nodes.reference):
                continue
            name = match[1]
            if name not in self.env.found_docs:
                log.warning("no such page: %s", node.astext(), location=node, type="page_links")
                continue
            builder = self.env.app.builder
            target = builder.get_relative_uri(self.env.docname, name) + (match[2] or "")
            title = self.env.titles[name].astext() if name in self.env.titles else posixpath.basename(name)
            link = nodes.reference("", "", nodes.inline("", title), internal=True, refuri=target)
            node.replace_self(link)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the transform."""
    app.add_post_transform(PageLinks)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
