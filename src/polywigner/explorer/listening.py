"""Connections of the server: so many at once, and none that keeps its place without using it."""

from __future__ import annotations

import errno
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any
from weakref import WeakSet

from tornado.ioloop import IOLoop

__all__ = ["Connection", "Listener", "most_connections"]

_MOST = 256
_SYSTEMS_USUAL = 256  # descriptors of a process, where the system does not say
_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_PAUSE = 1.0  # seconds
_UNREAD_MS = 20_000  # a peer that takes nothing for so long has gone


def most_connections() -> int:
    """Half of the descriptors that this process may have: the rest is for files and children."""
    try:
        import resource
    except ImportError:  # not on this system
        return _SYSTEMS_USUAL // 2
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return _MOST if soft == resource.RLIM_INFINITY else max(4, min(_MOST, soft // 2))


class Connection(socket.socket):
    """Of one client; the first that is accepted has the number 1."""

    number = 0
    is_page = False
    """Whether it is the websocket of an open page, which stays."""


class Listener(socket.socket):
    """A socket that listens, made of another; what it accepts is limited in number.

    With ``most`` connections open, the oldest that is no page's makes room for a new one: clients
    that connect and ask for nothing keep nobody out. If all are pages', the new one is refused.
    """

    def __init__(
        self, listening: socket.socket, most: int, loop: Callable[[], Any] = IOLoop.current
    ) -> None:
        super().__init__(
            listening.family, listening.type, listening.proto, fileno=listening.detach()
        )
        self.setblocking(False)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux; those that it accepts inherit it
            self.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_MS)
        self.most, self._loop = most, loop
        self._accepted: WeakSet[Connection] = WeakSet()
        self._count = 0

    def accept(self) -> tuple[socket.socket, Any]:
        """As of any socket. BlockingIOError, of which servers think nothing, while there are no
        descriptors left; ConnectionAbortedError for one that is refused."""
        try:
            plain, address = super().accept()
        except OSError as error:
            if error.errno not in _EXHAUSTED:
                raise
            self._rest()
            raise BlockingIOError from None
        made = Connection(plain.family, plain.type, plain.proto, fileno=plain.detach())
        made.number = self._count = self._count + 1
        if not self._has_room():
            made.close()
            raise ConnectionAbortedError
        self._accepted.add(made)
        return made, address

    def _has_room(self) -> bool:
        there = [c for c in self._accepted if c.fileno() >= 0]
        if len(there) < self.most:
            return True
        others = [c for c in there if not c.is_page]
        if not others:
            return False
        oldest = min(others, key=lambda c: c.number)
        with suppress(OSError):  # it may have gone by itself
            oldest.shutdown(socket.SHUT_RDWR)  # its stream finds the end, and closes it
        return True

    def _rest(self) -> None:
        """Accept nothing for a second: a socket with clients that wait would be asked at once."""
        logging.getLogger("polywigner.explorer").error(
            "the system has no descriptors left for another connection; new ones wait"
        )
        loop = self._loop()
        loop.update_handler(self.fileno(), 0)
        loop.call_later(_PAUSE, self._resume)

    def _resume(self) -> None:
        if self.fileno() >= 0:  # not closed meanwhile
            self._loop().update_handler(self.fileno(), IOLoop.READ)
