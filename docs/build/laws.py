"""Tables of the control laws in the guide and the reference, from the catalogue: a law that is added appears without a change here."""

import mkdocs_gen_files
from vlab.controllers.catalogue import LAWS, CatalogueLaw

from vlab.lab.laws import law_names
from vlab.structure import load_structure

PAGES = ("guide/laws.md", "reference/laws.md")
MARK = "<!-- laws of the catalogue -->"
STRUCTURES = ("beam", "grid")


def source_of(law: CatalogueLaw, printed: dict[str, list[str]]) -> str:
    """Return the source of a law's gains in ``vlab experiment``."""
    if law.estimated_by:
        return f"cannot run: no sensors measure every state; take `{law.estimated_by}`"
    having = [name for name, laws in printed.items() if law.name in laws]
    return f"printed for {' and '.join(having)}, else designed" if having else "designed for the rate of the loop"


def law_table() -> str:
    """Return the table of all laws by name."""
    printed = {name: law_names(load_structure(name)) for name in STRUCTURES}
    rows = [f"| `{law.name}` | {law.words} | {source_of(law, printed)} |" for law in LAWS.values()]
    return "\n".join(["| `--law` | meaning | gains in `vlab experiment` |", "|---|---|---|", *rows])


def main() -> None:
    """Write the tables into their pages."""
    for page in PAGES:
        with mkdocs_gen_files.open(page, "r") as file:
            text = file.read()
        if MARK not in text:
            raise ValueError(f"{page} has no line {MARK!r}")
        with mkdocs_gen_files.open(page, "w") as file:
            file.write(text.replace(MARK, law_table()))


if __name__ == "<run_path>":
    main()
