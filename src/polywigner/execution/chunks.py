"""Samples chunk by chunk: each is fetched while the next one is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.threads import check_not_stopped

__all__ = ["Fetch", "Launched", "chunks_of", "parts_of_results", "ready", "store"]

Array = npt.NDArray[Any]
Fetch = Callable[[], tuple[Array, ...]]
"""Waits for the results of a chunk that has begun to be computed."""
Launched = Iterator[tuple[Sequence[Array], Any, Fetch]]
"""(results, where in them, how to fetch them); there the work has begun already."""


def store(launched: Launched) -> None:
    """Fetch each chunk while the next one is computed."""
    last: Any = None
    for chunk in launched:
        check_not_stopped()
        if last is not None:
            _write(*last)
        last = chunk
    if last is not None:
        _write(*last)


def _write(results: Sequence[Array], where: Any, fetch: Fetch) -> None:
    for result, values in zip(results, fetch(), strict=True):
        result[where] = values


def ready(values: tuple[Array, ...]) -> Fetch:
    """Results that have been computed."""
    return lambda: values


def parts_of_results(
    components: Sequence[Array], results: Sequence[Array], size: int
) -> Iterator[tuple[list[Array], list[Array]]]:
    """The components chunk by chunk as `chunks_of`, with the parts of the results for each."""
    flat = [result.reshape(-1) for result in results]
    start = 0
    for arguments in chunks_of(components, results[0].shape, size):
        end = start + len(arguments[0])
        yield arguments, [result[start:end] for result in flat]
        start = end


def chunks_of(
    components: Sequence[Array], shape: tuple[int, ...], size: int
) -> Iterator[list[Array]]:
    """The components in float64, broadcast to a shape, chunk by chunk in C order."""
    whole = [c if c.shape == shape else np.broadcast_to(c, shape) for c in components]
    arguments: list[Any]
    if 0 < whole[0].size <= size:
        yield [c.astype(np.float64, copy=False).reshape(-1) for c in whole]
        return
    with np.nditer(
        whole,
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=[["readonly"]] * len(whole),
        op_dtypes=[np.dtype(np.float64)] * len(whole),
        order="C",
        buffersize=size,
    ) as iterator:
        for chunk in iterator:
            # of one operand nditer gives the array itself
            arguments = list(chunk) if len(whole) > 1 else [chunk]
            if arguments[0].size:
                yield arguments
