"""Cross sections that are saved part by part, so that the same command continues after an end."""

from __future__ import annotations

import hashlib
import json
import sys
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import __version__
from polywigner.execution.progress import progress_bar
from polywigner.interruption import atomic_path
from polywigner.scattering.section_patterns import Pattern

# Seconds between two times at which finished parts are written.
_INTERVAL = 5.0


class SavedParts:
    """A file with the cross sections that are computed so far.

    Parameters
    ----------
    path : the file.
    pattern : any pattern of the run.
    options : further options on which the patterns depend, as JSON takes them.
    """

    def __init__(self, path: Path, pattern: Pattern, options: Any) -> None:
        self._path = path
        self._key = _digest(pattern, options)
        self._values: list[NDArray[np.float64]] = []
        self.steps: tuple[float, float] | None = None
        """Steps of the map and of the cuts in degrees of an earlier run; None without a file."""
        try:
            with np.load(path) as content:
                if content["key"] == self._key:
                    self._values = [content[f"values_{k}"] for k in range(len(content) - 2)]
                    self.steps = tuple(content["steps"].tolist())
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            pass  # no file, or another one: it is replaced

    def computed(self, patterns: Sequence[Pattern], steps: tuple[float, float]) -> list[Any]:
        """Return the datasets of patterns with these steps; values in the file are reused."""
        every = self._values if self.steps else [np.full(one.shape, np.nan) for one in patterns]
        missing = [np.asarray(np.isnan(values).any(axis=1)) for values in every]
        total = sum(values.size for values in every)
        done = sum(values[~rows].size for values, rows in zip(every, missing, strict=True))
        if done:
            sys.stderr.write(f"polywigner: continues at {done} of {total} directions\n")
        with progress_bar("directions", total, done) as advance:
            saved = time.monotonic()
            try:
                for pattern, values, rows in zip(patterns, every, missing, strict=True):
                    for numbers, part in pattern.parts(rows):
                        values[numbers] = part
                        advance(part.size)
                        if time.monotonic() - saved > _INTERVAL:
                            self._write(every, steps)
                            saved = time.monotonic()
            except KeyboardInterrupt:
                self._write(every, steps)
                raise
        pairs = zip(patterns, every, strict=True)
        return [pattern.dataset(values) for pattern, values in pairs]

    def remove(self) -> None:
        """Remove the file, whose values are in the results."""
        self._path.unlink(missing_ok=True)

    def _write(self, every: Sequence[NDArray[np.float64]], steps: tuple[float, float]) -> None:
        arrays: dict[str, Any] = {f"values_{k}": values for k, values in enumerate(every)}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(self._path) as scratch:
            np.savez(scratch, key=self._key, steps=steps, **arrays)


def _digest(pattern: Pattern, options: Any) -> str:
    """Return the digest of all that the values depend on."""
    facets = pattern.facets
    settings = __version__, pattern.wavelength, pattern.polarisation, pattern.bounces, options
    content = hashlib.sha256(json.dumps(settings).encode())
    for array in (facets.corners, facets.is_plate):
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
