"""Chunks computed by the cores of this machine, or by a cluster that dask.distributed runs."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from polywigner import execution
from polywigner.errors import EngineError, PolywignerError, StoreError
from polywigner.propagation.stores_files import required
from polywigner.propagation.stores_layout import Index
from polywigner.propagation.stores_writer import ChunkWriter

__all__ = ["connected", "on_cluster", "on_this_machine"]

Advance = Callable[[], None]

# Seconds to wait for a scheduler's answer, and for its first worker.
_PATIENCE = 10.0


def on_this_machine(
    writer: ChunkWriter, indices: Sequence[Index], threads: int | None, advance: Advance
) -> None:
    """All chunks, by threads of this process. Raises what the first chunk to fail raises.

    Of a block that has a pool of threads of its own, one is computed while another is written.
    """
    cores = os.cpu_count() or 1
    stop = threading.Event()
    with ThreadPoolExecutor(
        2 if writer.exclusive else threads or cores,
        initializer=execution.stop_this_thread_when,
        initargs=(stop,),
    ) as pool:
        futures = [pool.submit(writer, index) for index in indices]
        try:
            for future in as_completed(futures):
                future.result()
                advance()
        except BaseException:  # KeyboardInterrupt too
            stop.set()  # chunks begun are given up, since they may take minutes
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler at an address, which has workers. Raises EngineError without."""
    distributed = required("distributed")
    if "://" not in scheduler and not re.fullmatch(r"[^\s/]+:\d+", scheduler):
        # distributed would say the same with a traceback when its client is collected
        raise EngineError(
            f"expected the address of a dask scheduler such as tcp://host:8786, got {scheduler!r}"
        )
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except Exception as error:  # of many kinds where something else answers, or it is no address
        raise EngineError(
            f"expected a dask scheduler at {scheduler!r}, got none that answers "
            f"({type(error).__name__}: {error}); start one by `dask scheduler`, or leave "
            "the address out"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            raise EngineError(
                f"expected workers at the scheduler {scheduler!r}, got none within "
                f"{_PATIENCE:g} s; start some by `dask worker {scheduler}`"
            ) from error
        yield client


def on_cluster(
    writer: ChunkWriter, indices: Sequence[Index], client: Any, advance: Advance
) -> None:
    """All chunks, by the workers of a client's scheduler.

    A worker that dies has its chunks computed by others. Raises, before any chunk is begun,
    StoreError if a worker does not see the store and EngineError if one lacks polywigner; else what
    the first chunk to fail raises.
    """
    distributed = required("distributed")
    dask = required("dask")
    for worker, answer in client.run(writer.check, on_error="return").items():
        if isinstance(answer, PolywignerError):
            raise answer
        if isinstance(answer, Exception) and not isinstance(answer, OSError):  # has just died
            raise EngineError(
                f"expected workers with polywigner, got none that works at {worker} "
                f"({type(answer).__name__}: {answer}); install the same everywhere"
            ) from answer
    # As a node of the graph it is sent once, and again to whoever replaces a dead worker.
    node = dask.delayed(writer, traverse=False, pure=False)
    call = dask.delayed(_write, pure=False)
    futures = client.compute([call(node, index) for index in indices])
    try:
        for future in distributed.as_completed(futures, loop=client.loop):
            if future.status != "finished":
                future.result()
            # Not kept by the worker, whose death would have it computed again.
            future.release()
            advance()
    except PolywignerError:
        raise
    except distributed.KilledWorker as error:
        raise StoreError(
            f"expected workers that live, got a chunk at which several died: {error}; give "
            "them more memory and start the same run again: what is finished stays"
        ) from error


def _write(writer: ChunkWriter, index: Index) -> None:
    from distributed import get_worker

    if writer.threads is None:
        # Its share of the machine's cores, since several workers may share the machine.
        writer = replace(writer, threads=get_worker().state.nthreads)
    writer(index)
