"""The page for ``panel serve``: ``panel serve -m polywigner.explorer.app`` or this file's path."""

from polywigner.explorer.page import Explorer

Explorer().page().servable()
