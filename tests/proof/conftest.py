"""Concealed cases that are quick to make, and a diagnosis that always answers the same."""

import shutil
from pathlib import Path

import pytest
from sealed_cases import ANSWER

import vlab.proof.prove as proving
from vlab.proof.conceal import conceal_cases
from vlab.proof.seal import truth_folder


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """Two null cases on the slider: quick to make."""
    cases = tmp_path_factory.mktemp("sealed") / "cases"
    conceal_cases(cases, suites=["null"], count=2, seed=3, benches=["slider"], jobs=1)
    return cases


@pytest.fixture
def cases(made, tmp_path) -> Path:
    shutil.copytree(made, tmp_path / "cases")
    shutil.copytree(truth_folder(made), tmp_path / "cases-truth")
    return tmp_path / "cases"


@pytest.fixture
def answered(monkeypatch):
    """Replace the diagnosis by a constant answer; count the calls."""
    calls = []

    def answer(item, *, baselines=False, slow_on=(), peers=()):
        calls.append(item[0])
        return item[0], {"case": item[0], **ANSWER}

    monkeypatch.setattr(proving, "answer_case", answer)
    return calls
