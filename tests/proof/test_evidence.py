"""The shipped campaign: it is as large as promised, sealed, and counts to the score that is shown."""

import json
import shutil

import pytest

from vlab.assets import asset
from vlab.errors import BadProof
from vlab.proof.concealing import truth_folder
from vlab.proof.prove import ANSWERS, SCORE, answers_folder, prove
from vlab.views.proof_report import write_proof

CASES = asset("evidence") / "cases"
LEAST = {
    "in-library": 120,
    "null": 60,
    "other-form": 40,
    "out-of-library": 40,
}
LEAST_HARD = 40
"""Two effects and masked together."""


@pytest.fixture
def shipped(tmp_path):
    """A copy: counting writes the score anew."""
    for folder in (CASES, truth_folder(CASES), answers_folder(CASES)):
        shutil.copytree(folder, tmp_path / folder.name)
    return tmp_path / CASES.name


def assert_same(now, then):
    """Counts and words must be equal; of intervals and fits other versions of scipy may differ in the last digits."""
    if isinstance(then, dict):
        assert set(now) == set(then)
        for key in then:
            assert_same(now[key], then[key])
    elif isinstance(then, list):
        for one, other in zip(now, then, strict=True):
            assert_same(one, other)
    elif isinstance(then, float):
        assert now == pytest.approx(then, rel=1e-6, abs=1e-9)
    else:
        assert now == then


def test_the_evidence_counts_to_the_score_that_is_shown(shipped, tmp_path):
    found = prove(shipped, answers_folder(shipped))
    assert found["cases"] >= 300
    kept = json.loads((answers_folder(CASES) / SCORE).read_text())
    counted = json.loads((answers_folder(shipped) / SCORE).read_text())
    assert_same(counted, kept)
    write_proof(found, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().count("<svg") == 4


def test_the_evidence_is_as_large_as_promised():
    suites = json.loads((answers_folder(CASES) / SCORE).read_text())["suites"]
    for name, least in LEAST.items():
        assert suites[name]["cases"] >= least, name
    assert suites["two-effects"]["cases"] + suites["masked"]["cases"] >= LEAST_HARD


@pytest.mark.parametrize("which", ["truth", "answer"])
def test_a_change_of_the_evidence_is_noticed(shipped, which):
    path = truth_folder(shipped) / "case-007.json"
    if which == "answer":
        path = answers_folder(shipped) / ANSWERS / "case-007.json"
    document = json.loads(path.read_text())
    (document["truth"] if which == "truth" else document)["verdict"] = "something else"
    path.write_text(json.dumps(document))
    with pytest.raises(BadProof, match="changed"):
        prove(shipped, answers_folder(shipped))
