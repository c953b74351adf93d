"""The --spp option for `make demo` on this machine: nothing with LLVM, one sample without.

Without LLVM scenes are rendered with scalar_rgb, one sample at a time: at the scenes' own number
of samples the demo would take hours, at one it takes some minutes and shows noisy pictures.
"""

from __future__ import annotations

import sys

from polywigner.llvm import prepare


def main() -> None:
    if prepare().usable:
        return
    sys.stderr.write(
        "polywigner: without LLVM the demo renders one sample per pixel: expect noise, and say "
        "DEMO_SPP=16 for better pictures in more time.\n"
    )
    print("--spp 1")


if __name__ == "__main__":
    main()
