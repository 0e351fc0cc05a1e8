"""``python -m vlab``: the command line."""

import os
import sys

import vlab

if __name__ == "__main__":
    # `python -m` looks for modules in the current folder first, which may be one of data; vlab's own checkout may stay
    if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(os.path.abspath(vlab.__file__))):
        del sys.path[0]
    from vlab.cli import main

    sys.exit(main())
