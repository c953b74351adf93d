"""What messages tell of a file that may be none of its format: places, and no lines of it.

A command may be pointed at any file, and its error be seen by others than the file's owner. So of
a text that does not parse, a message tells the place; of a value, a number or a known word.
"""

from __future__ import annotations

import re

__all__ = ["place_of", "token"]

_PLACE = re.compile(r"\bline (\d{1,9})(?:,? col(?:umn)? (\d{1,9}))?")
_NUMBER = re.compile(r"[-+.,;:\s0-9eE]{1,12}", re.ASCII)


def place_of(error: Exception) -> str:
    """ " in line 3, column 7" where the message of an error says so, else nothing."""
    found = _PLACE.search(str(error))
    if found is None:
        return ""
    return f" in line {found[1]}" + (f", column {found[2]}" if found[2] else "")


def token(text: str, known: tuple[str, ...] = ()) -> str:
    """A text as messages quote it: a short number, or a known word; of any other its length."""
    if text in known or _NUMBER.fullmatch(text):
        return repr(text)
    return f"{len(text)} characters of text" if text else "nothing"
