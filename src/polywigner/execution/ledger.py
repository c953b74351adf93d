"""What calls of this process have set up and have cost: what a plan may count on."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

from polywigner.plans import Plan, Request

__all__ = ["Account", "account_of", "counted_on"]


@dataclass
class Account:
    """Of one function of one source."""

    ready: frozenset[Hashable] = frozenset()
    """Keys of the plans that have been set up."""
    spent: float = 0.0
    """Estimated seconds of all calls, without what was set up once."""

    def book(self, plan: Plan) -> None:
        """A call that has been carried out."""
        global _as_code
        with _lock:
            self.spent += plan.way.run
            if plan.way.is_for_all:
                _for_all.setdefault(_kind(plan.request), set()).add(plan.key)
            elif plan.key not in self.ready:
                self.ready |= {plan.key}
                _as_code += plan.engine != "numpy"


_accounts: dict[tuple[str, int], Account] = {}
_for_all: dict[tuple[str, bool], set[Hashable]] = {}
"""Of each function and precision, what has been set up for every source."""
_as_code = 0
"""Kernels that were compiled for one source each."""
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


def counted_on(request: Request, account: Account) -> Request:
    """The request with what this process has set up so far, and has spent."""
    with _lock:
        ready = account.ready | _for_all.get(_kind(request), set())
        return replace(request, ready=ready, spent=account.spent, others=_as_code)


def _kind(request: Request) -> tuple[str, bool]:
    return request.function, request.double
