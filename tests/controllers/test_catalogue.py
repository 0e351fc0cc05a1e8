"""The catalogue of laws: one entry makes a law known to every command and page."""

import json
import runpy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from command import run
from vlab.controllers.catalogue import LAWS, CatalogueLaw
from vlab.controllers.rate_feedback_design import RateFeedbackDesign

from vlab.cli import main
from vlab.design.closed_loop import RateFeedbackLoop
from vlab.design.state_model import state_model
from vlab.errors import BadController
from vlab.lab.laws import named_law
from vlab.structure import load_structure

ROOT = Path(__file__).parents[2]
GAIN = 5.0
"""Gain of the toy law at every coil [N s/m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EqualGains(RateFeedbackDesign):
    """The same gain at every coil."""

    law: str = field(default="equal-gains", init=False)

    def goal(self, bounded):
        return {"name": "gain of every coil", "value": GAIN, "unit": "N s/m"}


def equal_gains(fe, asked):
    model = state_model(fe)
    return EqualGains(
        model=model,
        loop=RateFeedbackLoop(fe.linear, fe.coils),
        D=GAIN * np.eye(len(model.channels)),
        damping=asked.damping,
        bounded=(0,),
        search=None,
    )


@pytest.fixture
def toy(monkeypatch):
    law = CatalogueLaw(name="equal-gains", words="the same gain at every coil", design=equal_gains)
    monkeypatch.setitem(LAWS, law.name, law)
    return law.name


def test_the_toy_law_is_designed(toy, capsys):
    status, out, _ = run(capsys, "design", "beam", "--law", toy, "--json")
    document = json.loads(out)
    assert status == 0
    assert document["gains"]["D"] == (GAIN * np.eye(3)).tolist()
    assert document["objective"] == {"name": "gain of every coil", "value": GAIN, "unit": "N s/m"}
    assert document["model"] == "exact"  # no structure is named whose published design is on the full model
    assert min(document["damping_ratios"]) > 0.0
    assert "search" not in document


def test_the_toy_law_runs_in_a_loop(toy, capsys, tmp_path):
    law = named_law(load_structure("beam"), toy)
    assert np.array_equal(law.step(np.ones(3)), -GAIN * np.ones(3))
    words = (
        "experiment",
        "beam",
        "--plant",
        "linear",
        "--law",
        toy,
        "--seconds",
        "0.5",
        "--out",
        str(tmp_path / "run"),
    )
    assert run(capsys, *words)[0] == 0


@pytest.mark.parametrize("verb", ["design", "experiment"])
def test_help_names_the_toy_law(toy, capsys, verb):
    with pytest.raises(SystemExit):
        main([verb, "--help"])
    assert toy in capsys.readouterr().out


def test_a_mistyped_name_suggests_the_toy_law(toy, capsys):
    for words in (("design", "beam"), ("experiment", "beam")):
        status, _, error = run(capsys, *words, "--law", "equal-gain")
        assert status == 2
        assert f"did you mean {toy!r}?" in error


def test_the_documents_list_the_toy_law(toy):
    pytest.importorskip("mkdocs_gen_files")
    table = runpy.run_path(str(ROOT / "docs" / "build" / "laws.py"), run_name="laws")["law_table"]()
    assert f"| `{toy}` | the same gain at every coil | designed for the rate of the loop |" in table
    assert all(f"| `{name}` |" in table for name in LAWS)


def test_the_pages_have_a_place_for_the_table():
    for page in ("guide", "reference"):
        assert "<!-- laws of the catalogue -->" in (ROOT / "docs" / page / "laws.md").read_text(encoding="utf-8")


def test_a_law_on_all_states_names_its_estimator():
    with pytest.raises(BadController, match="the law lqr feeds every state back, .* take lqg, which estimates them"):
        named_law(load_structure("beam"), "lqr")


def test_estimators_are_laws_on_sensors():
    for law in LAWS.values():
        assert not law.estimated_by or not LAWS[law.estimated_by].estimated_by
