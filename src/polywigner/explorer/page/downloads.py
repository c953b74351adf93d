"""Files that visitors take away, and the address that restores the page."""

from __future__ import annotations

import base64
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from bokeh.models import CustomJS

from polywigner.explorer import exports
from polywigner.explorer.page import script
from polywigner.explorer.page.guards import on_change, on_click
from polywigner.explorer.page.show import show_code
from polywigner.explorer.snippets import snippet
from polywigner.explorer.state import State

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session

__all__ = ["connect_downloads"]

_KINDS = {
    "png": "image/png", "svg": "image/svg+xml", "npz": "application/octet-stream",
    "py": "text/x-python", "geojson": "application/geo+json",
}  # fmt: skip


def _taken(state: State, name: str, kind: str) -> bytes:
    """A view as a file of this kind."""
    if kind == "py":
        return snippet(state, name).encode()
    if kind == "npz":
        return exports.values_file(state, name)
    return exports.picture_file(state, name, kind)


def connect_downloads(session: Session) -> None:
    """The buttons below "Take away"."""
    controls = session.controls
    session.downloads.js_on_change(
        "data", CustomJS(args={"files": session.downloads}, code=script.DOWNLOAD)
    )
    # what nothing in the page refers to is not sent to it
    known = {
        "link": controls.link, "files": session.downloads, "keys": session.keys,
        "refused": session.refused, "pointed": session.pointed, "stale": session.status.stale,
    }  # fmt: skip
    controls.link.js_on_change("value", CustomJS(args=known, code=script.ADDRESS))
    on_change(session, controls.take, "value", lambda _: show_code(controls, session.state))

    def send(suffix: str, name: str, content: bytes) -> None:
        session.downloads.data = {
            "name": [f"{name}.{suffix}"],
            "kind": [_KINDS[suffix]],
            "content": [base64.b64encode(content).decode("ascii")],
        }

    def take(kind: str) -> None:
        name, state = controls.take.value, session.state
        session.aside(partial(_taken, state, name, kind), partial(send, kind, name))

    for kind, button in controls.files.items():
        on_click(session, button, partial(take, kind))

    def outline(suffix: str, written: Callable[[Any], str]) -> None:
        send(suffix, "aperture", written(session.state).encode())

    for name, suffix, written in (
        ("geojson", "geojson", exports.geojson),
        ("outline_svg", "svg", exports.svg),
    ):
        on_click(session, controls.outlines[name], partial(outline, suffix, written))
