"""The documentation site: `make docs` builds it into docs/_build/html.

Its sources are the pages of the repository where they stand (README, docs/, the examples), so that
every link and picture works in both places; docs/toc.yml puts them into order. The lessons are run:
an assertion that fails there fails the build.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import polywigner
from polywigner.toolchain import llvm

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
    "sphinx_gallery.gen_gallery",
    "docstrings",
    "mathml",
]
include_patterns = ["*.md", "docs/*.md", "docs/api/*.rst", "docs/lessons/lesson_*.rst"]
include_patterns += ["docs/theory/*.md", "docs/howto/*.md", "examples/*/README.md"]
include_patterns += ["benchmarks/README.md", "benchmarks/recorded/comparison.md"]
exclude_patterns = [".*", "build", "dist", "out", "src", "tests", "docs/_build"]
external_toc_path = "docs/toc.yml"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
nitpicky = True

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # ```math, as code hosts have it
html_math_renderer = "mathml"
highlight_language = "none"  # indented blocks are formulas
bibtex_bibfiles = ["../src/polywigner/references.bib"]  # the one that pw.cite reads

# Without LLVM, Mitsuba's scalar variants take minutes for lesson 103: it is then shown without what
# it draws.
LESSONS = r"/lesson_\d+" if llvm.prepare().usable else r"/lesson_(?!103)\d+"
sphinx_gallery_conf = {
    "examples_dirs": "examples/lessons",
    "gallery_dirs": "docs/lessons",
    "filename_pattern": LESSONS,
    "within_subsection_order": "FileNameSortKey",
    "reference_url": {"polywigner": None},
    "image_srcset": ["2x"],
    "write_computation_times": False,
    "download_all_examples": False,
    "min_reported_time": 3600,
    "plot_gallery": True,
}

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
    "header_links_before_dropdown": 8,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}

# A link to a folder shows its files on a code host, and one to a lesson its code; here they show
# the folder's page, and the lesson with what it draws.
LINK = re.compile(r"\]\(([^):#]+)\)")
# A link to a work in docs/sources.md stays, and gets its number; the list there is the site's own.
WORK = re.compile(r"\[([^]\[]+)\]\([./]*sources\.md#(\w+)\)")
LIST = re.compile(r"<!-- filled: references -->.*?<!-- end -->", re.DOTALL)
BIBLIOGRAPHY = "```{bibliography}\n:all:\n:style: unsrt\n```"
LESSON = re.compile(r"\]\([./]*examples/lessons/(lesson_\w+)\.py\)")


def link_to_pages(app: Any, page: str, text: list[str]) -> None:
    here = Path(app.env.doc2path(page)).parent

    def page_of(link: re.Match[str]) -> str:
        has_page = (here / link[1] / "README.md").is_file()
        return f"]({link[1]}/README.md)" if has_page else link[0]

    plain = LIST.sub(BIBLIOGRAPHY, WORK.sub(r"\1 {cite:p}`\2`", text[0]))
    text[0] = LINK.sub(page_of, LESSON.sub(r"](/docs/lessons/\1.rst)", plain))


def setup(app: Any) -> None:
    app.connect("source-read", link_to_pages)
