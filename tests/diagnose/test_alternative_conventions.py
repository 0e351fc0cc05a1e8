"""What a case leaves open and recordings tell beside what was found: when inputs act, whether recordings begin in motion."""

import dataclasses

import numpy as np
import pytest
from rig_folder import multisine
from scipy import signal
from test_sampling_convention import DAMPING, MASS, NOISE, RATE, SECONDS, STIFFNESS, case, recorded

from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.alternative_conventions import list_conventions
from vlab.diagnose.search.model_class import choose_model_class
from vlab.diagnose.search.sampling_convention import with_hold

DELAY = 0.030


def late_and_held(truth, kind, level, rng):
    """Rows of a file whose inputs act a while after they are written, and stand."""
    rows = recorded("zero", kind, level, rng)
    behind = round(DELAY * RATE)
    rows["u"] = np.append(rows["u"][behind:], multisine(rng, 0.5, 60.0, SECONDS, level)(np.arange(behind) / RATE))
    return rows


def thrown(truth, kind, level, rng):
    """Rows of a mass that passes its rest at speed where the file begins."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    u = multisine(rng, 0.5, 20.0, SECONDS, level)(time)
    system = ([[0.0, 1.0], [-STIFFNESS / MASS, -DAMPING / MASS]], [[0.0], [1.0 / MASS]], np.eye(2), [[0.0], [0.0]])
    _, y, _ = signal.lsim(system, u, time, X0=[0.0, 0.06 * level], interp=False)
    return {"u": u, "y": y[:, 0] + NOISE * y[:, 0].std() * rng.standard_normal(len(time))}


def begun_anyhow(case):
    """Return a case that does not say how its recordings begin."""
    tables = tuple(dataclasses.replace(t, initial="auto") for t in case.table.recording)
    return dataclasses.replace(case, table=dataclasses.replace(case.table, recording=tables))


def test_what_a_case_leaves_open_may_be_read_otherwise(tmp_path):
    problem = choose_model_class(begun_anyhow(case(tmp_path, "linear"))).problem
    inputs, starts = list_conventions(problem)
    assert {c.hold for t in inputs.of(problem.case).table.recording for c in t.channel if c.input} == {"zero"}
    assert {t.initial for t in starts.of(problem.case).table.recording} == {"estimated"}
    stated = dataclasses.replace(problem, case=starts.of(inputs.of(problem.case)))
    assert list_conventions(stated) == []


def test_a_hold_that_the_recordings_decided_is_opened_again(tmp_path):
    stated = case(tmp_path, "linear")
    problem = choose_model_class(stated).problem
    decided = dataclasses.replace(problem, case=with_hold(stated, "zero"), timing="decided")
    assert list_conventions(decided) == []
    (other,) = list_conventions(decided, stated)
    for of in (decided.case, stated):  # the prepared case, and the case as it is stated
        assert {c.hold for t in other.of(of).table.recording for c in t.channel if c.input} == {"linear"}
    said = other.of(stated)
    assert list_conventions(decided, said) == []  # what the case says stays


@pytest.mark.slow
def test_a_delay_does_not_take_half_a_sample_for_its_own(tmp_path):
    done = diagnose(case(tmp_path, "zero", rows=late_and_held)).diagnosis
    (finding,) = done.findings
    assert finding.effect == "actuator-delay"
    low, high = finding.parameters["delay"]["ci90"]
    # half a sample is 1 ms; a tenth of a sample is what a sampled model of a delay may be off by
    assert low - 2e-4 < DELAY < high + 2e-4


@pytest.mark.slow
def test_recordings_that_begin_at_speed_lack_nothing(tmp_path):
    done = diagnose(begun_anyhow(case(tmp_path, "zero", hold="zero", rows=thrown))).diagnosis
    assert done.verdict == "nothing-missing"
    assert done.heldout["nrmse_before"] < 1.3 * done.heldout["nrmse_noise"]
