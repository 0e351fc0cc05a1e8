"""Guarded entry point of ``vlab`` and ``python -m vlab``."""

import os
import sys

import vlab
from vlab.interrupts import LeavingAtOnce


def main() -> int:
    """Run the command of the process's arguments; return its exit status."""
    with LeavingAtOnce():
        if sys.argv[1:] == ["--version"]:  # without the imports of the command line
            print(f"vlab {vlab.__version__}")
            return 0
        if "_ARGCOMPLETE" in os.environ:  # the shell asks for completions
            from vlab.cli.completion import answer_shell

            answer_shell()
            return 0
        from vlab.cli import main as run
    return run(sys.argv[1:])


if __name__ == "__main__":
    # `python -m` looks for modules in the current folder first, which may be one of data; vlab's own checkout may stay
    if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(os.path.abspath(vlab.__file__))):
        del sys.path[0]
    sys.exit(main())
