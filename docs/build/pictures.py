"""The pictures that the pages show besides those of the effects, copied from the assets."""

from pathlib import Path

import mkdocs_gen_files

FIGURES = Path(__file__).parents[2] / "assets" / "figures"

for picture in sorted(FIGURES.glob("*.svg")):
    with mkdocs_gen_files.open(f"figures/{picture.name}", "wb") as file:
        file.write(picture.read_bytes())
