"""Kernels that Dr.Jit traces once for a source, and launches again without tracing.

To trace a kernel takes as long as to compute it for some ten thousand samples, again in each call.
A function frozen by Dr.Jit (``drjit.freeze``) repeats what it has launched, for any number of
samples, in a hundredth of a millisecond.
"""

from __future__ import annotations

import gc
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from polywigner.execution.drjit_operations import DrjitOperations
from polywigner.kernels import Kernel
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.tables import Tables, cut_of
from polywigner.plans import unrolls_terms

# What is remembered: of so many sources and kinds of arrays, and of each so many configurations
# (arguments that are one number, and others).
_MOST, _MOST_RECORDINGS = 64, 8

Values = tuple[Any, ...]
Function = Callable[..., Values]


class _Frozen:
    """A function that is recorded when it is first called."""

    def __init__(self, function: Function, owners: Sequence[Any]) -> None:
        import drjit

        # Dr.Jit goes through all that a function refers to in each call, but not through an object.
        held = _Held(function)

        def replayed(*arguments: Any) -> Values:
            return held.function(*arguments)

        self.replayed = drjit.freeze(replayed, limit=_MOST_RECORDINGS, warn_after=1 << 30)
        self.owners = owners
        # Dr.Jit ends the process when two threads record one function at the same time.
        self.lock = threading.Lock()

    def __call__(self, *arguments: Any) -> Values:
        with self.lock, without_collection():
            try:
                found: Values = self.replayed(*arguments)
            except RuntimeError as error:
                # Dr.Jit's own, in place of what stopped the function: an interrupt, for one
                raise error.__cause__ or error from None
            return found


_paused: list[bool] = []
"""For each recording that goes on: whether garbage was collected before it."""


@contextmanager
def without_collection() -> Iterator[None]:
    """No garbage is collected meanwhile.

    Dr.Jit ends the process when an array that holds memory of NumPy's is freed in a thread that is
    recording, and whatever a collection frees would be freed there.
    """
    with _lock:
        _paused.append(gc.isenabled())
        gc.disable()
    try:
        yield
    finally:
        with _lock:
            was_enabled = _paused.pop()
            if _paused:
                _paused[0] |= was_enabled
            elif was_enabled:
                gc.enable()


class _Held:
    def __init__(self, function: Function) -> None:
        self.function = function


_known: OrderedDict[Hashable, _Frozen] = OrderedDict()
_lock = threading.Lock()


def frozen(function: Function, owners: Sequence[Any], *kind: Hashable) -> Function:
    """A function of Dr.Jit arrays, or one that is known from an earlier call.

    It must not depend on the number of samples, nor bring memory of its own into being.

    ``owners``: the objects on which it depends, as such and not by their values; ``kind``: what
    else it depends on.
    """
    key = (*map(id, owners), *kind)
    with _lock:
        if key not in _known:
            _known[key] = _Frozen(function, owners)  # keeps the owners, and with them their ids
            while len(_known) > _MOST:
                _known.popitem(last=False)
        _known.move_to_end(key)
        return _known[key]


def is_code(kernel: Kernel, ops: DrjitOperations, tables: Any) -> bool:
    """Whether all that a kernel is told of a source is constants of its code, not memory."""
    if not isinstance(tables, (Tables, OutlineTables)):
        return False
    if isinstance(tables, Tables) and tables.coherence is not None:
        return False  # nodes of rules are memory
    if kernel.slices is not None and isinstance(tables, Tables):
        return cut_of(ops.target, tables) == "code"
    return unrolls_terms(len(tables.edges))


def is_recording(kind: Any) -> bool:
    """Whether Dr.Jit records the computation, or the type belongs to another backend than LLVM."""
    import drjit

    scopes = (drjit.JitFlag.SymbolicScope, drjit.JitFlag.FreezingScope)
    return drjit.backend_v(kind) != drjit.JitBackend.LLVM or any(map(drjit.flag, scopes))


def is_known(components: Sequence[Any]) -> bool:
    """Whether arrays are evaluated, without derivatives, and nothing is being recorded."""
    import drjit

    if is_recording(components[0]):
        return False
    # what is yet to be computed is so together with the kernel
    known = (drjit.VarState.Evaluated, drjit.VarState.Literal)
    return all(c.state in known and not drjit.grad_enabled(c) for c in components)
