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
_MOMENT = 0.02  # seconds in which a stream finds that its connection has ended
_PART = 8  # the oldest eighth makes room
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
    is_ended = False
    is_page = False
    """Whether it is the websocket of an open page, which stays."""


class Listener(socket.socket):
    """A socket that listens, made of another; what it accepts is limited in number.

    With ``most`` connections open, the oldest that are no page's make room for new ones: clients
    that connect and ask for nothing keep nobody out. If all are pages', a new one is refused.
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
        """As of any socket. BlockingIOError, of which servers think nothing, while there is no
        room; ConnectionAbortedError for one that is refused."""
        there = [c for c in self._accepted if c.fileno() >= 0]
        others = [c for c in there if not c.is_page]
        if len(there) >= self.most and others:
            self._end_oldest(others)
            self._rest(_MOMENT)
            raise BlockingIOError
        made, address = self._new()
        if len(there) >= self.most:
            made.close()
            raise ConnectionAbortedError
        self._accepted.add(made)
        return made, address

    def _new(self) -> tuple[Connection, Any]:
        try:
            plain, address = super().accept()
        except OSError as error:
            if error.errno not in _EXHAUSTED:
                raise
            logging.getLogger("polywigner.explorer").error(
                "the system has no descriptors left for another connection; new ones wait"
            )
            self._rest(_PAUSE)
            raise BlockingIOError from None
        made = Connection(plain.family, plain.type, plain.proto, fileno=plain.detach())
        made.number = self._count = self._count + 1
        return made, address

    def _end_oldest(self, connections: list[Connection]) -> None:
        kept = sorted((c for c in connections if not c.is_ended), key=lambda c: c.number)
        for oldest in kept[: max(1, self.most // _PART)]:
            oldest.is_ended = True
            with suppress(OSError):  # it may have gone by itself
                oldest.shutdown(socket.SHUT_RDWR)  # its stream finds the end, and closes it

    def _rest(self, seconds: float) -> None:
        """Accept nothing for a while: a socket with clients that wait would be asked at once."""
        loop = self._loop()
        loop.update_handler(self.fileno(), 0)
        loop.call_later(seconds, self._resume)

    def _resume(self) -> None:
        if self.fileno() >= 0:  # not closed meanwhile
            self._loop().update_handler(self.fileno(), IOLoop.READ)
