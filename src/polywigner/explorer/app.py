"""The page for ``panel serve``: ``panel serve -m polywigner.explorer.app`` or this file's path."""

from polywigner.explorer.page import new_page

new_page().servable()
