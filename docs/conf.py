"""The documentation site: `make docs` builds it into docs/_build/html.

Its sources are the pages of the repository where they stand (README, docs/, the examples), so that
every link and picture works in both places; docs/toc.yml puts them into order.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import polywigner

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "polywigner"
author = "The polywigner developers"
copyright = author
version = release = polywigner.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_external_toc",
    "myst_parser",
    "sphinxcontrib.bibtex",
    "docstrings",
]
include_patterns = ["*.md", "docs/*.md", "docs/api/*.rst", "examples/*/README.md"]
exclude_patterns = [".*", "build", "dist", "out", "src", "tests", "docs/_build"]
external_toc_path = "docs/toc.yml"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
nitpicky = True

myst_heading_anchors = 3
highlight_language = "none"  # indented blocks are formulas
bibtex_bibfiles = ["../src/polywigner/references.bib"]  # the one that pw.cite reads

# Shapes and units are in the docstrings; the types of the code say little more than "array".
autodoc_typehints = "none"
autodoc_member_order = "groupwise"
autodoc_class_signature = "mixed"
add_module_names = False

html_theme = "pydata_sphinx_theme"
html_title = f"polywigner {version}"
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_extra_path = ["site/index.html"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "polywigner"},
    "show_prev_next": False,
    "header_links_before_dropdown": 7,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}

# A link to a folder shows its files on a code host; here it shows the folder's page.
LINK = re.compile(r"\]\(([^):#]+)\)")


def link_to_pages_of_folders(app: Any, page: str, text: list[str]) -> None:
    here = Path(app.env.doc2path(page)).parent

    def page_of(link: re.Match[str]) -> str:
        has_page = (here / link[1] / "README.md").is_file()
        return f"]({link[1]}/README.md)" if has_page else link[0]

    text[0] = LINK.sub(page_of, text[0])


def setup(app: Any) -> None:
    app.connect("source-read", link_to_pages_of_folders)
