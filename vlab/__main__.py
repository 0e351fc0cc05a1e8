"""``python -m vlab``: the command line."""

import sys

from vlab.cli import main

if __name__ == "__main__":
    sys.exit(main())
