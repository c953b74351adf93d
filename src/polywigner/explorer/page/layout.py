"""Where things are: the controls beside the figures, or above them in a narrow window."""

from __future__ import annotations

from typing import Any

from bokeh.events import DocumentReady
from bokeh.layouts import column, row
from bokeh.models import CustomJS, InlineStyleSheet

from polywigner.explorer.page import script

__all__ = ["SIDE_WIDTH", "arranged", "connect_layout", "figure_grid"]

SIDE_WIDTH = 325
"""Width of the column of controls in pixels, its scroll bar counted."""
_NARROW = 760  # pixels: below it, controls lie above the figures

# Both parts scroll by themselves: who moves a slider sees the figure that it moves.
_PAGE = f"""
:host {{ display: flex !important; width: 100% !important; height: 100vh; overflow: hidden; }}
@media (max-width: {_NARROW}px) {{ :host {{ flex-direction: column !important; }} }}
"""
_SIDE = f"""
:host {{ flex: 0 0 {SIDE_WIDTH}px !important; height: 100vh; overflow: hidden auto;
  box-sizing: border-box; border-right: 1px solid #ddd; scrollbar-width: thin; }}
@media (max-width: {_NARROW}px) {{
  :host {{ flex: 0 0 40vh !important; width: 100% !important; height: 40vh;
    border-right: none; border-bottom: 1px solid #ddd; }}
}}
"""
_MAIN = """
:host { flex: 1 1 0 !important; min-width: 0 !important; min-height: 0 !important; overflow: auto;
  scrollbar-width: thin; }
"""
_TOP = """
:host { position: sticky; top: 0; left: 0; z-index: 20; background: white;
  width: 100% !important; }
"""
_GRID = """
:host { display: grid !important; flex: none !important; height: max-content !important;
  grid-auto-rows: max-content; align-items: start; justify-content: start;
  grid-template-columns: repeat(var(--polywigner-columns, 3), max-content); }
"""


def _styled(text: str) -> list[Any]:
    return [InlineStyleSheet(css=text)]


def figure_grid(figures: list[Any]) -> Any:
    """Figures in as many columns as there is room for."""
    return row(*figures, stylesheets=_styled(_GRID), name="figures")


def arranged(side: Any, top: list[Any], grid: Any) -> Any:
    """The page: controls, messages, and figures."""
    side.stylesheets = _styled(_SIDE)
    main = column(
        row(*top, stylesheets=_styled(_TOP)), grid, stylesheets=_styled(_MAIN), name="main"
    )
    return row(side, main, stylesheets=_styled(_PAGE), name="page")


def connect_layout(doc: Any, page: Any, figures: list[Any]) -> None:
    """Figures as large as the window lets them be."""
    known = {"page": page, "figures": figures, "beside": SIDE_WIDTH, "narrow": _NARROW}
    doc.js_on_event(DocumentReady, CustomJS(args=known, code=script.ARRANGE))
    doc.js_on_event(DocumentReady, CustomJS(args={"figure": figures[0]}, code=script.QUICK_PAINT))
