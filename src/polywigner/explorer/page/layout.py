"""Where things are: the controls beside the figures, or over them in a narrow window."""

from __future__ import annotations

from typing import Any

from bokeh.events import DocumentReady
from bokeh.layouts import column, row
from bokeh.models import CustomJS, InlineStyleSheet

from polywigner.explorer.page import script, theme

__all__ = ["arranged", "connect_layout"]


def _styled(text: str) -> list[Any]:
    return [InlineStyleSheet(css=text)]


def arranged(head: Any, side: Any, figures: list[Any], point: Any) -> Any:
    """The page: a line of messages above controls and figures."""
    point.stylesheets = _styled(theme.POINT)
    grid = row(*figures, point, stylesheets=_styled(theme.GRID), name="figures")
    main = column(grid, stylesheets=_styled(theme.MAIN), name="main")
    for name, text in (("busy", theme.BUSY), ("message", theme.MESSAGE)):
        for made in head.select({"name": name}):
            made.stylesheets = _styled(text)
    head.stylesheets, side.stylesheets = _styled(theme.HEAD), _styled(theme.SIDE)
    return column(head, side, main, stylesheets=_styled(theme.PAGE), name="page")


def connect_layout(doc: Any, page: Any, figures: list[Any], drawer: Any, groups: list[Any]) -> None:
    """Figures as large as the window lets them be, and controls as many as it has room for."""
    known = {
        "page": page, "main": page.children[2], "figures": figures, "drawer": drawer,
        "groups": [group.heading for group in groups], "narrow": theme.NARROW,
        "heights": [group.height for group in groups],
    }  # fmt: skip
    doc.js_on_event(DocumentReady, CustomJS(args=known, code=script.ARRANGE))
    doc.js_on_event(DocumentReady, CustomJS(args={"figure": figures[0]}, code=script.QUICK_PAINT))
    doc.js_on_event(DocumentReady, CustomJS(args={"figures": figures}, code=theme.PAINT))
