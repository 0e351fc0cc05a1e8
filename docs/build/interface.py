"""Pages of the Python reference: one a package, with all its public modules, from the docstrings."""

import mkdocs_gen_files

PACKAGES = {
    "structure": "structures: parts, places, reader",
    "fe": "finite element models, reductions, correction",
    "plants": "MuJoCo models",
    "controllers": "control laws and their designs",
    "design": "weights, Riccati equations, closed loops, performance",
    "lab": "experiments, excitations, plans, run folders, theory of the sampled loop",
    "modal": "frequency responses, poles, mode shapes",
    "recordings": "readers and writers of recordings",
    "physics": "effects and how they enter a model",
    "cases": "cases: model, recordings, comparison",
}
MODULES = {
    "signals": "recordings, frequency responses, modal models",
    "units": "units at the edges",
    "errors": "errors that vlab raises",
}

FACE = ("diagnosis", "experiment", "modal_test", "design", "schema")

with mkdocs_gen_files.open("reference/api/vlab.md", "w") as page:
    page.write("# vlab\n\nThese names are imported from `vlab`: `vlab.Case`, `vlab.diagnose` and the others.\n\n")
    page.write("::: vlab.cases.case.Case\n    options:\n      heading_level: 2\n      show_root_full_path: false\n\n")
    for part in FACE:
        page.write(f"::: vlab.api.{part}\n    options:\n      show_root_heading: false\n")
        page.write("      show_root_toc_entry: false\n      heading_level: 2\n      show_root_full_path: false\n\n")
rows = ["| [`vlab`](api/vlab.md) | the public names: case, diagnosis, experiment, modal test, design |"]
for name, words in {**PACKAGES, **MODULES}.items():
    with mkdocs_gen_files.open(f"reference/api/{name}.md", "w") as page:
        page.write(f"# vlab.{name}\n\n::: vlab.{name}\n    options:\n      show_root_heading: false\n")
        page.write("      show_root_toc_entry: false\n      heading_level: 2\n")
        if name in PACKAGES:
            page.write("      show_submodules: true\n")
        if name == "cases":  # the page of the public names has it
            page.write('      filters: ["!^_", "!^Case$"]\n')
    rows.append(f"| [`vlab.{name}`](api/{name}.md) | {words} |")

with mkdocs_gen_files.open("reference/api.md", "w") as page:
    page.write(
        "# Python reference\n\nThese pages are generated from the docstrings. Arrays are in SI units unless a docstring states\n"
        "another unit. Names that begin with an underscore are private.\n\n"
        "[Use vlab from Python](../howto/python.md) is the way in. The modules inside `vlab.diagnose` may change at any time.\n\n"
        "| module | content |\n|---|---|\n" + "\n".join(rows) + "\n"
    )
