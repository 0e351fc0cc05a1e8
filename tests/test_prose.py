"""Prose of the rooms: rules for docstrings and comments that a program can check."""

import ast
import io
import re
import statistics
import tokenize
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
ROOMS = [
    "vlab/physics",
    "vlab/standalone",
    "vlab/cases",
    "vlab/recordings",
    "vlab/plants",
    "vlab/lab",
    "vlab/environments",
    "vlab/modal",
    "vlab/fe",
    "vlab/structure",
    "controllers",
    "vlab/design",
    "vlab/hardware",
    "vlab/files",
    "vlab/views",
    "vlab/api",
    "vlab/cli",
    "vlab/proof",
    "vlab/reproduce",
    "vlab/demo",
    "vlab/benchmark",
    "vlab/diagnose/settings",
    "vlab/diagnose/kernels",
    "vlab/diagnose/data",
    "vlab/diagnose/parameters",
    "vlab/diagnose/model_kinds",
    "vlab/diagnose/predictors",
    "vlab/diagnose/inference",
    "vlab/diagnose/search",
    "vlab/diagnose/validation",
    "vlab/diagnose/precheck",
    "vlab/diagnose/problem.py",
    "vlab/diagnose/diagnosis.py",
    "vlab/diagnose/findings.py",
    "vlab/diagnose/data_findings.py",
    "vlab/diagnose/verdict.py",
    "vlab/diagnose/advice.py",
    "vlab/diagnose/export.py",
    "vlab/diagnose/pipeline.py",
    "vlab/diagnose/frequency_pipeline.py",
    "vlab/__init__.py",
    "vlab/units.py",
    "vlab/signals.py",
    "vlab/errors.py",
    "vlab/interrupts.py",
]
"""Rooms that keep the rules; the list grows with each room."""
NOT_YET = {"vlab/proof/score.py", "vlab/proof/judge.py", "vlab/proof/statistics.py", "vlab/proof/equivalence.py"}
"""Modules pinned byte by byte in manifests of campaigns."""
LONGEST_FIRST, MEDIAN_FIRST = 15, 9
"""LONGEST_FIRST, MEDIAN_FIRST [words]: first line of a docstring, single and over a room."""
LONGEST_SENTENCE = 25
"""LONGEST_SENTENCE [words]: any sentence of a docstring."""
SHORT_BODY = 4
"""SHORT_BODY [lines]: longest body of a function whose signature alone may describe the result."""

SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "See Also", "Notes", "References", "Examples")
FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)


class Doc(NamedTuple):
    """A docstring with its place, and its owner (None for an attribute's)."""

    where: str
    text: str
    owner: Any

    @property
    def head(self) -> str:
        """Summary line and description."""
        return split(self.text)[0]

    @property
    def is_inherited(self) -> bool:
        """Whether the docstring refers to the method of the base class."""
        return self.text.startswith("See `")


def files(room: str) -> list[Path]:
    path = ROOT / room
    found = sorted(path.rglob("*.py")) if path.is_dir() else [path]
    return [p for p in found if str(p.relative_to(ROOT)) not in NOT_YET]


@cache
def docs(room: str) -> tuple[Doc, ...]:
    return tuple(doc for path in files(room) for doc in docs_of(path))


def docs_of(path: Path) -> Iterator[Doc]:
    name = str(path.relative_to(ROOT))
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        if isinstance(node, (ast.Module, ast.ClassDef, *FUNCTION)):
            text = ast.get_docstring(node)
            if text:
                yield Doc(f"{name}:{getattr(node, 'lineno', 1)}", text, node)
        for before, after in pairwise(body):
            if isinstance(before, (ast.Assign, ast.AnnAssign)) and isinstance(after, ast.Expr):
                value = after.value
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    yield Doc(f"{name}:{after.lineno}", value.value, None)


def split(text: str) -> tuple[str, dict[str, str]]:
    """Return the text before the numpy sections, and each section's text."""
    lines = text.split("\n")
    starts = [
        i
        for i in range(len(lines) - 1)
        if lines[i].strip() in SECTIONS and re.fullmatch(r"-{3,}", lines[i + 1].strip())
    ]
    head = "\n".join(lines[: starts[0]] if starts else lines).strip()
    return head, {lines[a].strip(): "\n".join(lines[a + 2 : b]) for a, b in pairwise([*starts, len(lines)])}


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a docstring, without names of parameters, types, sources, code and formulas."""
    head, sections = split(text)
    paragraphs = [p for p in re.split(r"\n\s*\n", head) if not p.startswith("    ")]  # an indented one is a formula
    for name, content in sections.items():
        if name in ("References", "See Also", "Examples"):
            continue
        entries = re.split(r"\n(?=\S)", content) if name != "Notes" else content.split("\n\n")
        paragraphs += [e.partition("\n")[2] if name != "Notes" else e for e in entries]
    for paragraph in paragraphs:
        for item in re.split(r"\n(?=- )", paragraph):
            plain = re.sub(r"``.*?``|`.*?`", "X", item, flags=re.S)
            plain = re.sub(r"\S*[=<>]\S*|\s[-+*/^]\s", " ", plain)  # terms of a formula are no words
            yield from re.split(r"(?<=[.!?:;])\s+", re.sub(r"\s+", " ", plain).strip())


def first_lines(room: str) -> list[tuple[str, str]]:
    return [(d.where, d.head.split("\n\n")[0]) for d in docs(room) if d.owner is not None and not d.is_inherited]


@pytest.mark.parametrize("room", ROOMS)
def test_a_first_line_is_one_short_line(room):
    long = [(w, s) for w, s in first_lines(room) if "\n" in s or len(s.split()) > LONGEST_FIRST]
    assert not long


@pytest.mark.parametrize("room", [room for room in ROOMS if not room.endswith(".py")])
def test_most_first_lines_are_short(room):
    assert statistics.median(len(s.split()) for _, s in first_lines(room)) <= MEDIAN_FIRST


@pytest.mark.parametrize("room", ROOMS)
def test_no_sentence_is_long(room):
    long = [(d.where, s) for d in docs(room) for s in sentences(d.text) if len(s.split()) > LONGEST_SENTENCE]
    assert not long


@pytest.mark.parametrize("room", ROOMS)
def test_a_module_head_or_class_is_named_by_a_noun(room):
    relative = re.compile(r"(What|How|Which|Where|Who|Whose|When|Whether|That which)\b")
    owners = (ast.Module, ast.ClassDef)
    assert not [d.where for d in docs(room) if isinstance(d.owner, owners) and relative.match(d.text)]


@pytest.mark.parametrize("room", ROOMS)
def test_numbers_have_a_leading_zero(room):
    bare = re.compile(r"(?<![\w.)\]])\.\d")
    wrong = [d.where for d in docs(room) if bare.search(re.sub(r"``.*?``", "", d.text, flags=re.S))]
    for path in files(room):
        source = io.StringIO(path.read_text(encoding="utf-8"))
        tokens = tokenize.generate_tokens(source.readline)
        wrong += [f"{path.name}:{t.start[0]}" for t in tokens if t.type == tokenize.COMMENT and bare.search(t.string)]
    assert not wrong


@pytest.mark.parametrize("room", ROOMS)
def test_recordings_and_models_do_not_speak(room):
    speech = re.compile(r"\b(believes?|believed|is told|are told|was told|asks (it|for)|worth saying)\b")
    assert not [(d.where, m.group()) for d in docs(room) if (m := speech.search(d.text))]


@pytest.mark.parametrize("room", ROOMS)
def test_a_public_function_states_its_result(room):
    silent = []
    for doc in docs(room):
        f = doc.owner
        if not isinstance(f, FUNCTION) or f.name.startswith("_") or doc.is_inherited or is_nested(f, room):
            continue
        arguments = [a for a in (*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs) if a.arg not in ("self", "cls")]
        result = "None" if f.returns is None else ast.unparse(f.returns)
        length = f.body[-1].end_lineno - f.body[0].end_lineno
        sections = split(doc.text)[1]
        if arguments and result != "None" and length > SHORT_BODY and not {"Returns", "Yields"} & set(sections):
            silent.append(f"{doc.where} {f.name}")
    assert not silent


@pytest.mark.parametrize("room", ROOMS)
def test_a_public_function_with_sections_describes_every_argument(room):
    missing = []
    for doc in docs(room):
        f, sections = doc.owner, split(doc.text)[1]
        is_plain = isinstance(f, FUNCTION) and not f.name.startswith("_") and not doc.is_inherited
        if not is_plain or is_nested(f, room) or not {"Parameters", "Returns", "Raises"} & set(sections):
            continue
        entries = re.findall(r"^(\S.*?) : ", sections.get("Parameters", ""), flags=re.M)
        described = {name.strip().lstrip("*") for entry in entries for name in entry.split(",")}
        arguments = {a.arg for a in (*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs)} - {"self", "cls"}
        if arguments - described:
            missing.append((doc.where, f.name, arguments - described))
    assert not missing


@cache
def nested(room: str) -> frozenset[tuple[str, int]]:
    """Return name and line of functions that are local to another function or to a private class."""
    out = set()
    for path in files(room):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            private = isinstance(node, ast.ClassDef) and node.name.startswith("_")
            if isinstance(node, FUNCTION) or private:
                out |= {(f.name, f.lineno) for f in ast.walk(node) if isinstance(f, FUNCTION) and f is not node}
    return frozenset(out)


def is_nested(function: Any, room: str) -> bool:
    return (function.name, function.lineno) in nested(room)
