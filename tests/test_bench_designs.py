"""The peers of the design bench are what they claim to be: the same designs by other means."""

import numpy as np

from vlab.benchmark import comparisons, stepping
from vlab.benchmark import designs as bench_designs
from vlab.design import performance
from vlab.design.published_tables import published_design, published_table
from vlab.design.state_model import state_model
from vlab.design.weights import noise_of, weights_of


def test_python_control_gives_the_same_table_9(fe):
    model, asked = state_model(fe), published_design("beam")
    gains = [published_table("beam", "7", law).si("N s/m") for law in ("mfdrf", "lqdrf")]
    given = (model, weights_of(asked, model), noise_of(asked, model), gains, performance.initial_states(model, 6))
    # two Riccati solvers on states that differ by 1e3 in size
    np.testing.assert_allclose(bench_designs._table_9(*given), bench_designs._table_9_with_control(*given), rtol=1e-6)


def test_slsqp_never_beats_the_design(fe):
    from vlab.controllers import mfdrf

    found = bench_designs.with_slsqp(fe, lambda D: float(performance.force_bounds(D).max()), seed=0)
    # SLSQP may use the slack of 1e-3 in the damping that `with_slsqp` allows it
    assert found >= mfdrf.design(fe).objective * (1 - 2e-3)


def test_every_plant_is_timed_beside_its_peer(monkeypatch):
    for name, value in (("SECONDS", 0.05), ("RUNS", 2), ("STRUCTURES", ("beam",))):
        monkeypatch.setattr(stepping, name, value)
    rows = comparisons.stepping_rows()
    assert [row.work.partition(" plant")[0].partition(", CPU")[0] for row in rows] == [
        "beam, composite",
        "beam, modal",
        "beam, fe",
        "beam, linear",
        "avc_cantilever/free_decay: a recording replayed without a law",
        "avc_cantilever/free_decay: a recording replayed with hysteresis at a joint",
        "emps/case: a recording replayed without a law",
        "emps/case: a recording replayed with hysteresis at a joint",
    ]
    assert all(row.ours_s > 0 and row.peer_s > 0 and row.ratio > 0 for row in rows)
    assert comparisons.as_document(rows)["rows"][3]["peer"].startswith("control.forced_response")


def test_two_works_take_turns():
    turns = []
    for is_warm in (False, True):
        stepping.cpu_times(lambda: turns.append("ours"), lambda: turns.append("peer"), 2, is_warm=is_warm)
    assert turns == ["ours", "peer"] * 5  # one turn more without warm works
