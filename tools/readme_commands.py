"""Print the shell commands of the README as a script, as a reader types them.

The block that clones the repository is omitted, and the clone is installed instead of the published
package. .ci/run runs the script in a new clone, in an environment that contains only what the
commands install.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path


def commands(readme: str) -> str:
    """Return the lines of all shell blocks except the block that clones the repository."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    script = "".join(block for block in blocks if not block.startswith("git clone"))
    return script.replace('pip install "polywigner', 'pip install ".')


if __name__ == "__main__":
    sys.stdout.write(commands(Path(__file__).parents[1].joinpath("README.md").read_text("utf-8")))
