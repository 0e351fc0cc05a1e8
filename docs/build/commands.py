"""The command reference, from the parsers of the commands themselves."""

import argparse

import mkdocs_gen_files

from vlab.cli import VERBS, build_parser

PAGE = "reference/commands.md"
HEAD = """# Commands

This page is generated from the parsers of the commands. `vlab COMMAND --help` prints the same text.

Every command accepts two options that are not repeated below:

- `--json` prints one JSON document to standard output and nothing else. Progress goes to standard error.
- `--debug` prints the traceback of an error.

| exit status | meaning |
|---|---|
| 0 | done |
| 1 | a check failed, or the simulation diverged |
| 2 | bad input; one line on standard error names the cause |
| 3 | fault of vlab itself; one line on standard error says how to report the fault |
| 130 | interrupted |
"""


def of_command(verb: str) -> str:
    """Return the section of one command."""
    (choices,) = (a for a in build_parser(verb)._actions if isinstance(a, argparse._SubParsersAction))
    parser = choices.choices[verb]
    parser.formatter_class = lambda prog: argparse.HelpFormatter(prog, width=84)
    actions = [a for a in parser._actions if not set(a.option_strings) & {"-h", "--json", "--debug"}]
    rows = [f"| {_name(a)} | {_cell(_meaning(a, parser))} | {_default(a)} |" for a in actions]
    table = ["| argument | meaning | default |", "|---|---|---|", *rows] if rows else ["No further arguments."]
    usage = parser.format_usage().removeprefix("usage: ").replace(" [-h] [--debug] [--json]", "")
    text = parser.description or VERBS[verb]
    return "\n".join(
        ["", f"## {verb}", "", f"{text[0].upper()}{text[1:]}.", "", "```text", usage.rstrip(), "```", "", *table, ""]
    )


def _name(action: argparse.Action) -> str:
    metavar = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or ())
    if action.choices is not None and not metavar:
        metavar = "{" + ",".join(map(str, action.choices)) + "}"
    if not action.option_strings:
        return f"`{metavar or action.dest}`"
    value = "" if action.nargs == 0 else f" {metavar or action.dest.upper()}"
    return ", ".join(f"`{option}{value}`" for option in action.option_strings)


def _meaning(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    return parser._get_formatter()._expand_help(action) if action.help else ""


def _default(action: argparse.Action) -> str:
    default = action.default
    if default is None or default is argparse.SUPPRESS or default in (False, [], (), "") or action.nargs == 0:
        return ""
    if isinstance(default, (list, tuple)):
        default = " ".join(map(str, default))
    return f"`{default}`"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


with mkdocs_gen_files.open(PAGE, "w") as page:
    page.write(HEAD + "".join(of_command(verb) for verb in VERBS))
