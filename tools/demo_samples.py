"""Print the options of renders for `make demo` on this machine.

With LLVM, the number of samples is the scene's own number. ``--diffraction [SPP]`` adds the options
for scenes whose shadows diffract, with LLVM.

Without LLVM, scenes are rendered with scalar_rgb, one sample at a time. With the scenes' own
numbers of samples the demo would take hours; with one sample per pixel it takes some minutes and
produces noisy images.
"""

from __future__ import annotations

import sys

from polywigner.llvm import prepare

# Samples per pixel with diffraction: a grid of 4 x 4 in each pixel.
_DIFFRACTING = "16"


def main() -> None:
    diffraction, spp = "--diffraction" in sys.argv, [s for s in sys.argv[1:] if s.isdigit()]
    if prepare().usable:
        if diffraction:
            print("--diffraction --integrator direct --spp", *(spp or [_DIFFRACTING]))
        return
    if diffraction and spp:
        print("--spp", *spp)
        return
    sys.stderr.write(
        "polywigner: without LLVM, the demo renders one sample per pixel, which is noisy; set "
        "DEMO_SPP=16 for better images in more time.\n"
    )
    print("--spp 1")


if __name__ == "__main__":
    main()
