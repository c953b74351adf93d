"""Opens the libraries that polywigner has unpacked before Dr.Jit is imported, whoever imports it.

``polywigner doctor --install-llvm`` puts a copy of this file into an environment where it has
unpacked libraries without root: there the dynamic linker does not find them, and ``import
mitsuba`` before ``import polywigner`` would die of a missing libatomic. Needs nothing until then.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence


class _BeforeDrjit:
    """An import hook that finds nothing, but prepares for Dr.Jit when Dr.Jit is looked for."""

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None = None, target: object = None) -> None:
        if name == "drjit":
            stand_down()
            # An import must not fail because of a courtesy, such as when polywigner is gone.
            with contextlib.suppress(Exception):
                from polywigner.toolchain.llvm import prepare

                prepare()


def stand_down() -> None:
    """Take the hook away: it is needed once, and not when polywigner comes first."""
    with contextlib.suppress(ValueError):
        sys.meta_path.remove(_BeforeDrjit)


# Not in the children in which prepare() tries libraries out: they would start children as well.
if __name__ == "polywigner_native" and "POLYWIGNER_TRIAL" not in os.environ:
    sys.meta_path.insert(0, _BeforeDrjit)
