"""The house: a module imports only from rooms above it, and data walks one way."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
ROOMS = [
    "vlab.errors",
    "vlab.interrupts",
    "vlab.units",
    "vlab.compilation",
    "vlab.parallel",
    "vlab.files",
    "vlab.signals",
    "vlab.structure",
    "vlab.fe",
    "vlab.design",
    "vlab.controllers",
    "vlab.plants",
    "vlab.modal",
    "vlab.recordings",
    "vlab.physics",
    "vlab.standalone",
    "vlab.hardware",
    "vlab.lab",
    "vlab.environments",
    "vlab.cases",
    "vlab.diagnose.settings",
    "vlab.diagnose.kernels",
    "vlab.diagnose.data",
    "vlab.diagnose.parameters",
    "vlab.diagnose.model_kinds",
    "vlab.diagnose.problem",
    "vlab.diagnose.predictors",
    "vlab.diagnose.inference",
    "vlab.diagnose.validation",
    "vlab.diagnose.diagnosis",
    "vlab.diagnose.findings",
    "vlab.diagnose.data_findings",
    "vlab.diagnose.verdict",
    "vlab.diagnose.search",
    "vlab.diagnose.advice",
    "vlab.diagnose.frequency_pipeline",
    "vlab.diagnose.pipeline",
    "vlab.diagnose.precheck",
    "vlab.diagnose.export",
    "vlab.proof",
    "vlab.reproduce",
    "vlab.demo",
    "vlab.views",
    "vlab.api",
    "vlab.benchmark",
    "vlab.cli",
    "vlab.__main__",
]
"""From the ground up; the rooms of the diagnosis one by one."""

FACES = ("vlab", "vlab.diagnose", "vlab.design")
"""Packages whose own module imports nothing of vlab when it is loaded, except for the types of `vlab`."""


def room_of(module: str) -> int | None:
    if module in FACES:
        return -1
    return next((i for i, room in enumerate(ROOMS) if module == room or module.startswith(room + ".")), None)


def parsed(path: Path) -> ast.Module:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if path == ROOT / "vlab" / "__init__.py":  # names the types of what is imported at first use, for type checkers
        tree.body = [node for node in tree.body if not isinstance(node, ast.If)]
    return tree


def imports_of(path: Path) -> list[str]:
    names = []
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.append(node.module)
    return [name for name in names if name.split(".")[0] == "vlab"]


@cache
def modules() -> list[tuple[str, Path]]:
    paths = [(p.relative_to(ROOT), p) for p in (ROOT / "vlab").rglob("*.py")]
    paths += [("vlab" / p.relative_to(ROOT), p) for p in (ROOT / "controllers").rglob("*.py")]
    return [(".".join(name.with_suffix("").parts).removesuffix(".__init__"), p) for name, p in paths]


def test_every_module_lives_in_a_room():
    homeless = [name for name, _ in modules() if room_of(name) is None]
    assert not homeless


def test_a_module_imports_only_from_rooms_above_it():
    wrong = []
    for name, path in modules():
        own = room_of(name)
        for used in imports_of(path):
            other = room_of(used)
            if other is None or (own is not None and other > own):
                wrong.append(f"{name} imports {used}")
    assert not wrong


def test_the_diagnosis_has_few_modules_outside_its_packages():
    assert len(list((ROOT / "vlab" / "diagnose").glob("*.py"))) <= 10


MOST_LINES_OF_MODULE, MOST_LINES_OF_FUNCTION = 500, 80
"""Longest module, and longest function without its docstring [lines]."""


def length_without_docstring(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the lines of a function from its `def` to its end, less those of its docstring."""
    first = function.body[0]
    is_doc = (
        isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str)
    )
    return function.end_lineno - function.lineno + 1 - (first.end_lineno - first.lineno + 1 if is_doc else 0)


def test_modules_are_short():
    lengths = {name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in modules()}
    assert not [name for name, lines in lengths.items() if lines > MOST_LINES_OF_MODULE]


def test_functions_are_short():
    long_functions = set()
    for name, path in modules():
        functions = [f for f in ast.walk(parsed(path)) if isinstance(f, (ast.FunctionDef, ast.AsyncFunctionDef))]
        long_functions |= {
            f"{name}.{f.name}" for f in functions if length_without_docstring(f) > MOST_LINES_OF_FUNCTION
        }
    assert not long_functions


GENERATOR = "vlab.proof.generator"
FOREIGN = ("vlab.fe", "vlab.plants", "vlab.physics", "vlab.diagnose", "vlab.cases", "vlab.lab", "mujoco")
"""What the diagnosis knows of structures and laws, and the hidden truth must not come from."""
SEALED_SOURCE = f"{GENERATOR}.laboratory"
"""Beam and grid of cases sealed before the generator had an FE code; remade bit for bit, hence with `vlab.fe`."""


def reached_from(start: str) -> dict[str, str]:
    """Return every module that a module imports, in turn, with the module that imports it."""
    paths = dict(modules())
    reached, left = {}, [start]
    while left:
        name = left.pop()
        used = {x for x in imported_by(paths[name]) if x not in reached and x != start}
        reached |= dict.fromkeys(used, name)
        left += [x for x in used if x in paths]
    return reached


@cache
def imported_by(path: Path) -> set[str]:
    """Return the modules of vlab and MuJoCo that a file imports, with those named as parts of a package."""
    known, found = {name for name, _ in modules()}, set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            parts = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (parts & known) | {node.module}
    return {name for name in found if name.split(".")[0] in ("vlab", "mujoco")}


def is_foreign(name: str, rooms: tuple[str, ...] = FOREIGN) -> bool:
    return any(name == room or name.startswith(room + ".") for room in rooms)


def test_hidden_structures_share_no_code_with_the_diagnosed_ones():
    """Whatever a module of the generator imports, in turn too; a common FE code hides its own errors from the score."""
    own = [name for name, _ in modules() if name.startswith(GENERATOR + ".") and name != SEALED_SOURCE]
    assert f"{GENERATOR}.structure_fe" in own
    for name in own:
        reached = reached_from(name)
        wrong = {used: by for used, by in reached.items() if is_foreign(used) or used == SEALED_SOURCE}
        assert not wrong, name


def test_the_sealed_source_of_structures_knows_only_the_fe_code():
    reached = reached_from(SEALED_SOURCE)
    others = tuple(room for room in FOREIGN if room != "vlab.fe")
    assert "vlab.fe.model" in reached
    assert not [used for used in reached if is_foreign(used, others)]


def test_control_laws_know_nothing_of_the_simulator():
    for name, path in modules():
        if name.startswith("vlab.controllers"):
            text = path.read_text(encoding="utf-8")
            assert "mujoco" not in text, name
            assert not [used for used in imports_of(path) if used.startswith(("vlab.plants", "vlab.lab"))], name


def test_top_level_is_what_the_readme_promises():
    visible = {p.name for p in ROOT.iterdir() if not p.name.startswith(".")} - {"out", "dist", "build"}
    assert visible - {"MUJOCO_LOG.TXT"} == {
        "pyproject.toml",
        "mkdocs.yml",
        "assets",
        "docs",
        "vlab",
        "controllers",
        "tests",
        "README.md",
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "CITATION.cff",
        "LICENSE",
    }
