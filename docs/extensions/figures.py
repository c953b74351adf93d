"""Scraper of sphinx-gallery that draws each figure of a lesson once, for screens of both densities.

Matplotlib draws the figure with twice its resolution. Means of 2 x 2 pixels are the image for
screens of low density, which takes much less time than drawing the figure again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from PIL import Image
from sphinx_gallery.scrapers import figure_rst


def scrape(_block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save all open figures, and return the directives that show them."""
    directives = []
    for number, path in zip(plt.get_fignums(), block_vars["image_path_iterator"], strict=False):
        figure = plt.figure(number)
        coarse = Path(path)
        fine = coarse.with_name(f"{coarse.stem}_2_00x.png")
        figure.savefig(fine, dpi=2 * figure.dpi)
        with Image.open(fine) as image:
            image.reduce(2).save(coarse)
        titles = ", ".join(filter(None, (axes.get_title() for axes in figure.axes)))
        paths = {0: coarse, 2.0: fine}
        directives.append(
            figure_rst([coarse], gallery_conf["src_dir"], titles, srcsetpaths=[paths])
        )
    plt.close("all")
    return "".join(directives)
