"""Configuration of the manual.  `gyroscreen docs` builds it from a copy of this folder, to which it adds the generated pages."""

import sys
from importlib import metadata
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "gyroscreen"
author = copyright = "The gyroscreen developers"
release = version = metadata.version("gyroscreen")
language = "en"

extensions = ["myst_nb", "sphinx_design", "sphinx.ext.autodoc", "docstrings", "mathml", "page_links", "page_list"]
exclude_patterns = ["_*", "**/README.md"]
templates_path: list[str] = []
# A notebook of the same name as a page is renamed when the sources are copied.
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb", ".rst": "restructuredtext"}

# A reference without a target is a fault; types in signatures are often internal, or those of other packages.
nitpicky = True
nitpick_ignore_regex = [(r"py:(class|obj|data)", r".*")]
# A page may skip a level of headings.
suppress_warnings = ["myst.header"]

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_block", "attrs_inline", "fieldlist"]
# Prices and shell variables are no formulas.
myst_dmath_allow_digits = False
myst_dmath_allow_space = False
myst_heading_anchors = 4
html_math_renderer = "mathml"

nb_execution_mode = "off"  # `gyroscreen docs` switches it on.
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_show_tb = True

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
add_module_names = False
# Code blocks without a language are output or equations in plain text.
highlight_language = "none"

html_theme = "pydata_sphinx_theme"
html_title = f"gyroscreen {release}"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
# Excerpts of the pages found would be fetched, which a browser refuses for files.
html_show_search_summary = False
html_context = {"default_mode": "auto"}
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False
html_last_updated_fmt = None
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "footer_start": [],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": [], "results": [], "CONTRIBUTING": [], "changelog": []}
