"""What calls of this process have set up and have cost: what a plan may count on."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

from polywigner.plans import Plan

__all__ = ["Account", "account_of"]


@dataclass
class Account:
    """Of one function of one source."""

    ready: frozenset[Hashable] = frozenset()
    """Keys of the plans that have been set up."""
    spent: float = 0.0
    """Estimated seconds of all calls, without what was set up once."""

    def book(self, plan: Plan) -> None:
        """A call that has been carried out."""
        with _lock:
            self.spent += plan.way.run
            self.ready |= {plan.key}


_accounts: dict[tuple[str, int], Account] = {}
_lock = threading.Lock()


def account_of(function: str, tables: Any) -> Account:
    """The account of a function and the tables of a source; it ends with the tables."""
    key = function, id(tables)
    with _lock:
        found = _accounts.get(key)
        if found is None:
            found = _accounts[key] = Account()
            weakref.finalize(tables, _accounts.pop, key, None).atexit = False
        return found
