"""Sums over many samples by lanes that take several of them, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

__all__ = ["stride_of", "summed_in_strides"]

# To add up values over the lanes of a processor takes as long as ten operations on them; of so many
# samples of a lane that is little, and more of them gain nothing.
_STRIDE = 16
# Lanes of a processor, at most.
_TOGETHER = 16
# Lanes that Dr.Jit hands to a thread at a time, and how many such blocks even out the threads.
_BLOCK, _BLOCKS = 1 << 14, 4


def stride_of(samples: int) -> int:
    """How many of so many samples a lane is to take."""
    import drjit as dr

    return int(max(1, min(_STRIDE, samples // (_BLOCK * _BLOCKS * dr.thread_count()))))


def summed_in_strides(
    real: Any,
    samples: int,
    stride: int,
    values: int,
    terms: Callable[[Callable[[Any], Any], Callable[[Any, Any], None]], Sequence[Any]],
) -> list[Any]:
    """Sums of ``values`` values over samples, less wide than these by ``stride``.

    ``terms(taken, put)``: the values of one sample in each lane. ``taken(array)`` is its entry for
    that sample, ``put(array, value)`` writes one.
    """
    import drjit as dr

    number = dr.uint32_array_t(real)
    lanes = -(-samples // (stride * _TOGETHER)) * _TOGETHER
    lane = dr.arange(number, lanes)
    # Neighbours in memory for the lanes of a processor, and for their next samples.
    first = (lane // _TOGETHER) * (stride * _TOGETHER) + lane % _TOGETHER
    last = dr.minimum(first + stride * _TOGETHER, dr.opaque(number, samples))

    def advanced(index: Any, *sums: Any) -> tuple[Any, ...]:
        def taken(array: Any) -> Any:
            return array if dr.width(array) == 1 else dr.gather(real, array, index)

        def put(array: Any, value: Any) -> None:
            dr.scatter(array, value, index, mode=dr.ReduceMode.Permute)

        found = terms(taken, put)
        return index + _TOGETHER, *(a + b for a, b in zip(sums, found, strict=True))

    _, *totals = dr.while_loop(
        (first, *(dr.zeros(real, lanes) for _ in range(values))),
        lambda index, *_: index < last,
        advanced,
        mode="symbolic",
        label="samples of a lane",
    )
    return list(totals)
