"""A diagnosis of an MJCF model writes its answer for MuJoCo alone, with calibrated numbers, report and JSON."""

import dataclasses
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "physics"))
from physics_rig import chain_rig

from vlab.cli.diagnose import _for_mujoco
from vlab.diagnose.export import write_extended_model
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.validation.gap import total
from vlab.diagnose.validation.simulation import ExtendedModel, check, extended
from vlab.physics.catalogue import effect_named
from vlab.views.reports.diagnosis import _without_vlab

pytestmark = pytest.mark.slow
"""The module's recordings are made, or diagnosed, once for all its tests, which takes most of a minute."""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("out")
    rig = chain_rig(step=1e-3)
    problem = rig.problem
    places = {name: p for p in problem.places for name in (p.name, *p.aliases)}
    terms = tuple(
        Term(effect=effect_named(name), place=places["joint:a"], values=values)
        for name, values in (("viscous-damping", {"damping": 2.0}), ("bouc-wen", {"force": 2.0, "yield": 0.004}))
    )
    theta = np.array([0.3 * (-1) ** i * p.sd for i, p in enumerate(problem.parameters)])
    zero = np.zeros(len(problem.names))
    fit = Fit(terms=terms, theta=theta, offsets=zero, starts={}, error=np.zeros((1, 1)), chi2=0.0, cost=0.0)
    before, after = extended(problem, dataclasses.replace(fit, terms=())), extended(problem, fit)
    checked = check(rig.case.runs(("fit",)), before, after, nominal=ExtendedModel(plant=rig.case.plant))
    finding = SimpleNamespace(to_json=lambda: {"effect": "bouc-wen", "explained": float("nan")})
    diagnosis = SimpleNamespace(findings=(finding,), checked=checked, heldout={"nrmse_after": total(checked, "after")})
    done = SimpleNamespace(
        problem=problem, diagnosis=diagnosis, fit=fit, before=before, after=after,
        choice=SimpleNamespace(best=SimpleNamespace(terms=terms)),
    )  # fmt: skip
    return SimpleNamespace(files=write_extended_model(done, folder), folder=folder, done=done)


def test_the_model_holds_calibrated_numbers_and_native_effects(written):
    answer, folder = written.files.mujoco, written.folder / "mujoco"
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    amended = mujoco.MjModel.from_xml_path(str(written.folder / "amended.xml"))
    for field in ("dof_damping", "jnt_stiffness", "body_mass", "body_inertia", "actuator_gainprm"):
        assert np.allclose(getattr(model, field), getattr(amended, field), rtol=1e-5), field  # MuJoCo writes six digits
    assert not np.allclose(model.jnt_stiffness, written.done.problem.case.plant.model.jnt_stiffness)
    assert answer.native == {"viscous-damping@joint:a": "damping"}
    assert "bouc-wen@joint:a" in answer.laws
    assert not answer.not_written
    assert all((folder / name).is_file() for name in answer.files)


def test_report_terminal_and_json_name_the_files(written):
    answer = written.files.mujoco
    (section,) = _without_vlab(written.files)
    assert "mujoco/model.xml" in section.text[0]
    assert ["viscous-damping@joint:a", "model.xml", "damping", None] in section.tables[0][1]
    plain = json.loads(json.dumps(answer.to_json()))
    assert plain["files"] == ["model.xml", "model.patch", "law.py", "numbers.json"]
    assert "  viscous-damping@joint:a: damping of the model" in _for_mujoco(plain, Path("out"))


def test_the_numbers_have_units(written):
    numbers = json.loads((written.folder / "mujoco" / "numbers.json").read_text())
    first = numbers["effects"][0]
    assert first["parameters"]["damping"] == {"value": 2.0, "unit": "N s/m"}
    assert (first["in"], first["as"]) == ("model", "damping")
    assert numbers["findings"] == [{"effect": "bouc-wen", "explained": None}]
    assert {"element": "joint:a", "attribute": "damping"}.items() <= next(
        c for c in numbers["changes"] if (c["element"], c["attribute"]) == ("joint:a", "damping")
    ).items()
