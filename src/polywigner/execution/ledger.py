"""What calls of this process have been set up and have cost: what a plan may count on."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from polywigner.plans import Plan

__all__ = ["Account", "account_of"]

# Sources and functions that are remembered, with their tables.
_MOST = 128


@dataclass
class Account:
    """Of one function of one source."""

    tables: Any
    ready: frozenset[str] = frozenset()
    """Ways that have been set up."""
    spent: float = 0.0
    """Estimated seconds of all calls, without what was set up once."""

    def book(self, plan: Plan) -> None:
        """A call that has been carried out."""
        self.spent += plan.way.run
        self.ready |= {plan.way.name}


_accounts: OrderedDict[tuple[str, int], Account] = OrderedDict()
_lock = threading.Lock()


def account_of(function: str, tables: Any) -> Account:
    """The account of a function and the tables of a source."""
    key = function, id(tables)
    with _lock:
        if key not in _accounts:
            _accounts[key] = Account(tables)  # keeps the tables, and with them their id
            while len(_accounts) > _MOST:
                _accounts.popitem(last=False)
        _accounts.move_to_end(key)
        return _accounts[key]
