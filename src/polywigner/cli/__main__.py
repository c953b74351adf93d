"""``python -m polywigner.cli``, for an environment whose scripts are not on the PATH."""

import sys

from polywigner.cli import main

sys.exit(main())
