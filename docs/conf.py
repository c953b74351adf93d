"""The documentation site: `make docs` builds it into docs/_build/html.

Its sources are the pages of the repository where they stand (README, docs/, the examples), so that
every link and picture works in both places; docs/toc.yml puts them into order. The lessons are run:
an assertion that fails there fails the build.
"""

from __future__ import annotations

import sys
from pathlib import Path

import polywigner
from polywigner import llvm

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
    "pages",
]
include_patterns = ["*.md", "docs/*.md", "docs/api/*.rst", "docs/lessons/lesson_*.rst"]
include_patterns += ["docs/theory/*.md", "docs/howto/*.md", "examples/*/README.md"]
include_patterns += ["benchmarks/README.md", "benchmarks/recorded/comparison.md"]
exclude_patterns = [".*", "build", "dist", "out", "src", "tests", "docs/_build", "paper"]
external_toc_path = "docs/toc.yml"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
nitpicky = True

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # ```math, as code hosts have it
html_math_renderer = "mathml"
highlight_language = "none"  # indented blocks are formulas
bibtex_bibfiles = ["../src/polywigner/references.bib"]  # the one that pw.cite reads

# Without LLVM, Mitsuba's scalar variants take minutes for lessons 103, 107, 108 and 110: they are
# then shown without what they draw.
LESSONS = r"/lesson_\d+" if llvm.prepare().usable else r"/lesson_(?!103|107|108|110)\d+"
sphinx_gallery_conf = {
    "examples_dirs": "examples/lessons",
    "gallery_dirs": "docs/lessons",
    "filename_pattern": LESSONS,
    "within_subsection_order": "FileNameSortKey",
    "reference_url": {"polywigner": None},
    "image_scrapers": ["figures.scrape"],
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
