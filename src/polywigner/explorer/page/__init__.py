"""The page itself: figures, widgets, and the session that joins them to states and views."""

from __future__ import annotations

from polywigner.explorer.page.session import open_page

__all__ = ["open_page"]
