"""Campaigns: answers that go on where they stopped, with the same code, on several cores."""

import json

import numpy as np
import pytest
from scipy import linalg
from sealed_cases import ANSWER, edit

import vlab.proof.prove as proving
from vlab.diagnose.settings import VERDICT
from vlab.errors import BadProof, VlabError
from vlab.proof import answer as answering
from vlab.proof.campaign import common_instructions, run_all
from vlab.proof.peers import registry
from vlab.proof.peers.result import Named, PeerResult
from vlab.proof.prove import prove
from vlab.proof.seal import ANSWERS, FROZEN, answers_folder


def test_a_campaign_goes_on_where_it_was_stopped(cases, monkeypatch):
    calls = []

    def stops(item, *, baselines=False, slow_on=(), peers=()):
        calls.append(item[0])
        if len(calls) == 2:
            raise KeyboardInterrupt
        return item[0], {"case": item[0], **ANSWER}

    out = answers_folder(cases)
    monkeypatch.setattr(proving, "answer_case", stops)
    with pytest.raises(KeyboardInterrupt):
        prove(cases, out, jobs=1)
    assert [p.name for p in (out / ANSWERS).iterdir()] == ["case-001.json"]
    assert not (out / FROZEN).exists()
    prove(cases, out, jobs=1)
    assert calls == ["case-001", "case-002", "case-002"]


def test_peers_answer_although_the_diagnosis_fails(cases, monkeypatch):
    def crashes(case):
        raise ZeroDivisionError

    named = Named(effect="stop", place="joint:drive", share=1.0)
    peer = registry.Peer(run=lambda case: PeerResult(named=named, names=("stop",), nrmse=0.5), is_slow=True)
    monkeypatch.setattr(answering, "diagnose", crashes)
    monkeypatch.setattr(registry, "PEERS", {"one": peer, "two": peer})
    found = prove(cases, answers_folder(cases), baselines=1, peers=["one"], jobs=1)
    row = next(r for r in found["baselines"] if r["method"] == "one")
    assert (row["usable"], row["false_alarms"]["count"], row["nrmse"]) == (
        1,
        1,
        0.5,
    )  # slow, so on the first case alone
    assert not [r for r in found["baselines"] if r["method"] == "two"]
    answer = json.loads((answers_folder(cases) / ANSWERS / "case-001.json").read_text())
    assert answer["verdict"] == "crashed"
    assert answer["baselines"]["one"]["cpu_seconds"] >= 0.0
    with pytest.raises(VlabError, match="no-peer"):
        prove(cases, answers_folder(cases), baselines=1, peers=["no-peer"], jobs=1)


def test_a_campaign_does_not_go_on_with_other_code(cases, monkeypatch):
    out = answers_folder(cases)
    monkeypatch.setattr(proving, "answer_case", lambda item, **settings: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        prove(cases, out, jobs=1)
    edit(out / "manifest.json", lambda d: d["thresholds"]["inference.model_choice"].update(explained=0.1))
    with pytest.raises(BadProof, match="begun with another thresholds"):
        prove(cases, out, jobs=1)


def test_the_manifest_binds_what_answers_depend_on(cases, answered):
    prove(cases, answers_folder(cases), jobs=1)
    kept = json.loads((answers_folder(cases) / "manifest.json").read_text())
    assert {"code", "catalogue", "structures", "thresholds", "thresholds_sha256", "commitments", "versions"} <= set(
        kept
    )
    assert kept["thresholds"]["verdict"]["least_gap"] == VERDICT.least_gap


def square(x: int) -> tuple[int, int]:
    return x, x * x


@pytest.mark.slow
def test_work_on_several_cores_is_complete():
    assert dict(run_all(square, range(5), jobs=2)) == {i: i * i for i in range(5)}


def bits_of_linear_algebra(x: int) -> tuple[int, bytes]:
    a = np.random.default_rng(x).standard_normal((60, 60))
    return x, linalg.eigh(a @ a.T)[1].tobytes()


@pytest.mark.slow
def test_numbers_come_out_with_the_same_bits_whatever_processor_linear_algebra_takes_this_for(monkeypatch):
    def made(**how):
        return dict(run_all(bits_of_linear_algebra, range(2), jobs=2, **how))

    here = made(environment=common_instructions())
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    if made() == here:
        pytest.skip("this linear algebra does not choose by the processor")
    assert made(environment=common_instructions()) == here


def test_work_on_dask_is_complete():
    pytest.importorskip("dask.distributed")
    assert dict(run_all(square, range(3), engine="dask", jobs=1)) == {i: i * i for i in range(3)}
