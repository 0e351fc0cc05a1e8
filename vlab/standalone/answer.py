"""Answer of a diagnosis as files for plain MuJoCo.

The folder holds ``model.xml`` with its patch, ``law.py`` for all effects without a MuJoCo element, and ``numbers.json``.
The written files are compiled again and compared with the computed model number by number.
"""

import difflib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure, OutputRefused
from vlab.files.output_folder import finite
from vlab.files.text import one_line
from vlab.physics.attach import Attached
from vlab.plants.mjcf import MjcfPlant
from vlab.plants.mjcf_guard import model_files
from vlab.standalone.law_module import LawModule, law_module
from vlab.standalone.mjcf_text import ModelText
from vlab.standalone.model_patch import NUMBERS, Changed, ModelPatch, differing, patched
from vlab.standalone.native_parts import NativeParts, native_parts

FOLDER, MODEL, PATCH, LAW, VALUES = "mujoco", "model.xml", "model.patch", "law.py", "numbers.json"
"""Names of the written folder and files."""


@dataclass(frozen=True, kw_only=True)
class StandaloneAnswer:
    """Written files of an answer.

    Parameters
    ----------
    files : tuple of str
        Files in the folder, without copied assets.
    native : dict of str to str
        MuJoCo element by effect and place.
    laws : dict of str to str
        Reason by effect and place that stands in ``law.py``.
    not_written : dict of str to str
        Reason by effect that stands nowhere.
    uses : tuple of str
        Functions of ``law.py`` that a simulation calls.
    changes : list of Changed
        Changed attributes of the model file.
    patch : str
        Unified diff of the model's text.
    """

    files: tuple[str, ...]
    native: dict[str, str]
    laws: dict[str, str]
    not_written: dict[str, str]
    uses: tuple[str, ...]
    changes: list[Changed] = field(default_factory=list)
    patch: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the answer for ``diagnosis.json``."""
        return {
            "folder": FOLDER,
            "files": list(self.files),
            "in_model": self.native,
            "in_law": self.laws,
            "not_written": self.not_written,
            "call": list(self.uses),
        }


def write_answer(
    source: Path,
    plant: MjcfPlant,
    effects: Sequence[Attached],
    folder: Path,
    *,
    channels: Sequence[str] = (),
    sample: float = 0.0,
    earlier: Sequence[Attached] = (),
    findings: Sequence[Mapping[str, Any]] = (),
) -> StandaloneAnswer:
    """Write a model with its effects for plain MuJoCo.

    Parameters
    ----------
    source : Path
        The user's model file.
    plant : MjcfPlant
        Plant of that file with calibrated numbers.
    effects : sequence of Attached
        Effects in the order in which they act.
    folder : Path
        Output folder; made if missing, and left as it is after a failure.
    channels : sequence of str
        Channel names of the case, which sensor effects may name.
    sample : float
        Sample period of the readings [s]; 0 for the integration step.
    earlier : sequence of Attached
        Effects that the plant has already as running physics.
    findings : sequence of mapping
        Findings of a diagnosis, for ``numbers.json``.

    Returns
    -------
    StandaloneAnswer
        Written files.

    Raises
    ------
    OutputRefused
        A file cannot be written.
    BadStructure
        The copied model does not load, or does not equal the computed one.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # beside the folder until all is checked, so that a failure leaves nothing
        with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as beside:
            part = Path(beside) / folder.name
            writer = _Writer(source.resolve(), plant, effects, part, channels, sample or plant.timestep, earlier)
            answer = writer.write(findings)
            shutil.copytree(part, folder, dirs_exist_ok=True)
            return answer
    except OSError as error:
        raise OutputRefused(
            f"the answer for MuJoCo cannot be written into {folder}: {error.strerror or error}"
        ) from error


@dataclass(frozen=True)
class _Writer:
    """Writer of one answer."""

    source: Path
    plant: MjcfPlant
    effects: Sequence[Attached]
    folder: Path
    channels: Sequence[str]
    sample: float
    earlier: Sequence[Attached]

    def write(self, findings: Sequence[Mapping[str, Any]]) -> StandaloneAnswer:
        nominal = mujoco.MjModel.from_xml_path(str(self.source))
        name, problem = self.copy(), ""
        for level in ("elements", "numbers", "law"):
            parts = native_parts(self.plant, self.effects, channels=self.channels, with_elements=level == "elements")
            wanted = self.computed(parts.spec)
            patch = self.patched(name, nominal, wanted, level)
            left, why = (None, "its text is unclear") if patch is None else self.compiled(name, wanted)
            if left is not None and patch is not None:
                break
            problem = problem or why
        if patch is None or left is None:
            raise BadStructure(f"{self.source.name}: {why}")
        law = law_module(
            parts.plant,
            model=name,
            title=f"Physics that the model {self.source.name} lacks.",
            sample=self.sample,
            numbers=left,
            shown=[*self.earlier, *parts.left],
        )
        return self.finish(name, parts, patch, law, left, findings, problem)

    def computed(self, spec: Any) -> Any:
        try:
            return spec.compile()
        except Exception as error:  # MuJoCo raises ValueError, FatalError and a few more with one meaning
            raise BadStructure(
                f"{self.source.name}: MuJoCo refuses the model with the answer's numbers: {one_line(error)}"
            ) from error

    def copy(self) -> str:
        """Copy a model's files, and return the model's new name."""
        self.folder.mkdir(parents=True, exist_ok=True)
        home, taken = self.source.parent, set()
        for path in sorted(model_files(self.source, self.source.name)):
            if path != self.source:
                relative = path.relative_to(home)
                taken.add(str(relative))
                (self.folder / relative).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, self.folder / relative)
        return next(n for n in (MODEL, *(f"model-{i}.xml" for i in range(2, len(taken) + 3))) if n not in taken)

    def target(self, name: str, path: Path) -> Path:
        return self.folder / (name if path == self.source else path.relative_to(self.source.parent))

    def patched(self, name: str, nominal: Any, wanted: Any, level: str) -> ModelPatch | None:
        """Write the edited text; None if the text cannot be edited."""
        try:
            text = ModelText(self.source)
            patch = ModelPatch(text=text)
            if level != "law":
                patch = patched(text, nominal, wanted, can_rename=level == "elements")
            for path in text.texts:
                self.target(name, path).write_bytes(text.written(path))
        except ValueError:
            return None
        return patch

    def compiled(self, name: str, wanted: Any) -> tuple[list[tuple[str, tuple[int, ...], float]] | None, str]:
        """Return numbers that the written file lacks, or None and the reason.

        None: setting numbers does not make the file equal to the computed model.
        """
        try:
            model = mujoco.MjModel.from_xml_path(str(self.folder / name))
        except Exception as error:  # MuJoCo raises ValueError, FatalError and a few more with one meaning
            return None, f"MuJoCo refuses the changed text: {one_line(error)}"
        numbers = []
        for field_name, mask in differing(wanted, model).items():
            if field_name not in NUMBERS or mask.shape != np.shape(getattr(wanted, field_name)):
                continue
            for index in zip(*np.nonzero(mask), strict=True):
                at = tuple(int(k) for k in index)
                numbers.append((field_name, at, float(getattr(wanted, field_name)[at])))
                getattr(model, field_name)[at] = numbers[-1][2]
        if numbers:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        still = differing(wanted, model)
        if still:
            return None, f"the changed text differs from the computed model in {', '.join(still)}"
        return numbers, ""

    def finish(
        self,
        name: str,
        parts: NativeParts,
        patch: ModelPatch,
        law: LawModule,
        left: Sequence[tuple[str, tuple[int, ...], float]],
        findings: Sequence[Mapping[str, Any]],
        problem: str,
    ) -> StandaloneAnswer:
        """Write patch, law module and numbers."""
        diff = "".join(self.diff(name, patch.text, path) for path in patch.text.changed)
        stated = [*self.earlier, *parts.left]
        refused = {e.label: law.refused[e.effect.name] for e in stated if e.effect.name in law.refused}
        reasons = dict.fromkeys((e.label for e in self.earlier), "the case states it") | parts.reasons
        laws = {k: f"{v}; {problem}" if problem else v for k, v in reasons.items() if k not in refused}
        files = [name, PATCH, *([LAW] if law.text else []), VALUES]
        files += [str(p.relative_to(self.source.parent)) for p in patch.text.texts if p != self.source]
        (self.folder / PATCH).write_text(diff, encoding="utf-8")
        if law.text:
            (self.folder / LAW).write_text(law.text, encoding="utf-8")
        document = {
            "model": name,
            "of": self.source.name,
            "units": "SI: kg, m, rad, s, N, N m; a command's unit is the actuator's own",
            "mujoco": mujoco.__version__,
            "timestep_s": float(parts.spec.option.timestep),
            "sample_s": self.sample,
            "findings": list(findings),
            "effects": [self.effect(e, parts, laws, refused) for e in (*self.earlier, *self.effects)],
            "changes": [vars(c) for c in patch.changes],
            "set_by_law": [{"field": f, "index": list(i), "value": v} for f, i, v in left],
        }
        (self.folder / VALUES).write_text(
            json.dumps(finite(document), indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        return StandaloneAnswer(
            files=tuple(files),
            native=parts.native,
            laws=laws,
            not_written=refused,
            uses=law.uses,
            changes=patch.changes,
            patch=diff,
        )

    def diff(self, name: str, text: ModelText, path: Path) -> str:
        new = str(self.target(name, path).relative_to(self.folder))
        before, after = (
            [line.decode("utf-8", "replace") for line in t.splitlines(keepends=True)]
            for t in (text.texts[path], text.written(path))
        )
        lines = difflib.unified_diff(before, after, f"a/{path.relative_to(self.source.parent)}", f"b/{new}")
        return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)

    @staticmethod
    def effect(
        one: Attached, parts: NativeParts, laws: Mapping[str, str], refused: Mapping[str, str]
    ) -> dict[str, Any]:
        """Return an effect for ``numbers.json``."""
        where = {"in": "model", "as": parts.native[one.label]} if one.label in parts.native else {"in": "law"}
        if one.label in refused:
            where = {"in": "nothing", "why": refused[one.label]}
        elif one.label in laws and where["in"] == "law":
            where["why"] = laws[one.label]
        return {
            "effect": one.effect.name,
            "place": one.place,
            "law": one.effect.law,
            "parameters": {p.name: {"value": float(one.values[p.name]), "unit": p.unit} for p in one.effect.parameters},
            **where,
        }
