"""Arguments of the commands that open a case."""

import argparse

OUTSIDE = "--allow-outside"


def add_case(
    parser: argparse.ArgumentParser, words: str = "read this case folder with case.toml, or case file"
) -> None:
    """Add the case and the permission to read files outside its folder.

    Parameters
    ----------
    parser : ArgumentParser
        Parser of the command.
    words : str
        Help of the argument.
    """
    parser.add_argument("case", help=words)
    parser.add_argument(
        OUTSIDE,
        action="store_true",
        help="read the files that the case names outside its folder, too (default: refuse such a file)",
    )
