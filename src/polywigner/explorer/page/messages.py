"""Many changes of a page in one message: sent, decoded and painted together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["together"]


@contextmanager
def together(doc: Any) -> Iterator[None]:
    """Changes of a document that go to the browser as one message.

    Bokeh sends each change by itself: half a millisecond for the list of all models that it makes
    for each, and a figure painted several times over. Callbacks on what is changed here are not
    called, as while widgets are filled.
    """
    if doc.callbacks.hold_value is not None:  # part of a larger whole
        yield
        return
    doc.hold("combine")
    try:
        yield
    finally:
        _send(doc)


def _send(doc: Any) -> None:
    session: Any = getattr(doc.session_context, "session", None)
    try:
        # of Bokeh's own, for which there is no public name
        events, writes = doc.callbacks._held_events, session._pending_writes
        connections = [(c.protocol, c._socket) for c in session._subscribed_connections]
    except AttributeError:  # another version, or no session yet
        doc.unhold()
        return
    if writes is None or not all(getattr(e, "setter", session) is None for e in events):
        doc.unhold()  # also of what is no change of a model, or comes from the browser
        return
    doc.callbacks._held_events = []
    doc.unhold()
    for protocol, socket in connections if events else ():
        writes.append(socket.send_message(protocol.create("PATCH-DOC", events)))
