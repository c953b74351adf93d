"""Callbacks of a page that answer faults with messages, and do not answer themselves."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from polywigner.errors import PolywignerError
from polywigner.explorer.logs import log_fault

if TYPE_CHECKING:
    from polywigner.explorer.page.session import Session


def guarded(session: Session, work: Callable[..., None]) -> Callable[..., None]:
    """Work that is left out while widgets are filled, and whose errors become messages."""

    def run(*arguments: Any) -> None:
        if session.filling:
            return
        try:
            work(*arguments)
        except PolywignerError as error:
            session.say(str(error))
        except Exception:  # no traceback reaches the page
            log_fault("a request failed")
            session.say("This could not be done; it is a fault of polywigner.")

    return run


def on_change(session: Session, widget: Any, name: str, work: Callable[[Any], None]) -> None:
    """Call work with the new value of a widget's property."""
    # Bokeh looks at the number of parameters: exactly three, by name
    safe = guarded(session, work)
    widget.on_change(name, lambda attr, old, new: safe(new))


def on_click(session: Session, button: Any, work: Callable[[], None]) -> None:
    """Call work when a button is pressed."""
    safe = guarded(session, work)
    button.on_click(lambda: safe())


def on_event(session: Session, figure: Any, event: Any, work: Callable[[Any], None]) -> None:
    """Call work with an event of a figure."""
    safe = guarded(session, work)
    figure.on_event(event, lambda happened: safe(happened))
