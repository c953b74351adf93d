"""Print the shell blocks of README as one script.

The block that clones the repository is omitted, the clone is installed instead of the published
package, and renders take few samples. .ci/run runs the script in a new clone, in an environment
that contains only the package.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path


def commands(readme: str) -> str:
    """Return the lines of all shell blocks except the block that clones."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    script = "".join(block for block in blocks if not block.startswith("git clone"))
    script = script.replace('pip install "polywigner', 'pip install ".')
    return re.sub(r"^(polywigner render .*)$", r"\1 --spp 16", script, flags=re.MULTILINE)


if __name__ == "__main__":
    sys.stdout.write(commands(Path(__file__).parents[1].joinpath("README.md").read_text("utf-8")))
