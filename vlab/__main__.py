"""``python -m vlab`` and the command ``vlab``: the command line, guarded from its first import on."""

import sys

from vlab.interrupts import LeavingAtOnce


def main() -> int:
    """Run the command of the process's arguments; return its exit status."""
    with LeavingAtOnce():
        from vlab.cli import main as run
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
