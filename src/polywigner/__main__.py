"""``python -m polywigner``: the command line, even if its script is not on the PATH."""

import sys

from polywigner.cli import main

if __name__ == "__main__":
    sys.exit(main())
