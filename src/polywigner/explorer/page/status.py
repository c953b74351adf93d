"""What the page says of its pictures: that they are ready, on their way, or of an older outline."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource, CustomJS

from polywigner.explorer.page import script
from polywigner.explorer.page.controls import VIEWS

__all__ = ["Status"]

_NEAR = ("rays_near", "exact_near", "difference_near")


def _figures(views: Collection[str]) -> list[str]:
    """Names of the figures of views."""
    return [f for view in views for f in (_NEAR if view == "near" else (view,))]


class Status:
    """The line above the figures, and the figures that are pale as they are of an older state."""

    def __init__(self, line: Any) -> None:
        self.line = line
        self.stale = ColumnDataSource({"figure": []}, name="stale")
        self.request = 0  # the number of the newest

    def show_on(self, doc: Any, figures: Sequence[Any]) -> None:
        """Let the page count seconds, and make older pictures pale."""
        counted = CustomJS(args={"busy": self.line}, code=script.ELAPSED)
        doc.js_on_event(DocumentReady, counted)
        pale = CustomJS(args={"figures": [*figures], "stale": self.stale}, code=script.STALE)
        self.stale.js_on_change("data", pale)
        doc.js_on_event(DocumentReady, pale)

    def _say(self, kind: str, text: str, stale: Collection[str]) -> None:
        # the page itself counts the seconds of what is "computing"
        self.line.text = (
            f'<span class="{kind}" data-request="{self.request}"><span role="status">{text}</span> '
            '<span class="elapsed" aria-hidden="true"></span></span>'
        )
        figures = _figures(stale)
        if self.stale.data["figure"] != figures:
            self.stale.data = {"figure": figures}

    def computing(
        self, asked: Sequence[str], todo: Sequence[tuple[str, int]], stale: Collection[str]
    ) -> None:
        """Say what is being computed of the views that were asked for.

        Parameters
        ----------
        asked : names of views.
        todo : what is still to be computed: names and samples along an axis, the first one now.
        stale : the views of which nothing has come yet.
        """
        pictures = [name for name in asked if name in VIEWS]
        done = len(set(pictures) - {name for name, _ in todo})
        text = "computing …"
        if todo and pictures:
            name, samples = todo[0]
            size = f", {samples} × {samples}" if samples else ""
            what = VIEWS.get(name, "values")
            text = f"computing {what}{size}: {done} of {len(pictures)} pictures done"
        self._say("computing", text, stale)

    def ready(self, views: Collection[str], trouble: bool, blank: bool) -> None:
        """Say that nothing more comes, and whether pictures are of the outline on show."""
        if blank:
            self._say("outdated", "nothing drawn", ())
        elif trouble:
            self._say("outdated", "pictures of an earlier state", [*views, "lags"])
        else:
            self._say("ready", "ready", ())
