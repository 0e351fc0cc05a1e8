"""The command line as a test calls it."""

from vlab.cli import main


def run(capsys, *words: str) -> tuple[int, str, str]:
    """Run one command; return its status, what it printed, and what it said on stderr."""
    capsys.readouterr()
    try:
        status = main(list(words))
    except SystemExit as stop:
        status = int(stop.code or 0)
    out, err = capsys.readouterr()
    return status, out, err
