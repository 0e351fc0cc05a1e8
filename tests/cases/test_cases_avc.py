"""The AVC cantilever: the nominal model against closed forms, its cases against the recordings."""

import json

import mujoco
import numpy as np
import pytest

from vlab.cases import compare_case, load_case
from vlab.files.assets import asset
from vlab.plants.chain import build_chain
from vlab.plants.mjcf import build_mjcf

LENGTH, WIDTH, THICKNESS, YOUNG, DENSITY = 0.55, 0.04, 0.003, 68e9, 2691.7
EI, MU = YOUNG * WIDTH * THICKNESS**3 / 12, DENSITY * WIDTH * THICKNESS
BETA = np.array([1.87510407, 4.69409113]) / LENGTH
"""Roots of 1 + cos(x) cosh(x) = 0 over the length; Blevins, Formulas for Natural Frequency and Mode Shape, table 8-1."""
MOMENT = 179e-12 / 16.4e-12 * 0.02 * (0.003 + 0.00025)
"""Piezo pair [N m/V]: d31/s11 b (h + hp)."""


@pytest.fixture(scope="module")
def rig():
    return build_mjcf(asset("cases/avc_cantilever/rig.xml"))


def slope(beta, x):
    """Slope of a clamped-free mode with a mean square deflection of one."""
    s = (np.sinh(beta * LENGTH) - np.sin(beta * LENGTH)) / (np.cosh(beta * LENGTH) + np.cos(beta * LENGTH))
    return beta * (np.sinh(beta * x) + np.sin(beta * x) - s * (np.cosh(beta * x) - np.cos(beta * x)))


def test_the_rig_rests_as_drawn_without_notes(rig):
    assert rig.notes == ()
    assert not rig.rest.any()
    assert [tap.name for tap in rig.sensors] == ["tip.x", "tip.y", "tip.z"]


def test_the_first_two_frequencies_are_those_of_a_clamped_beam(rig):
    exact = BETA**2 * np.sqrt(EI / MU) / (2 * np.pi)
    linear = rig.linearise()
    # Fourth-order chain of 8 links: +0.03 % and +0.35 % (the law of vlab/plants/chain.py).
    np.testing.assert_allclose(linear.freq[:2], exact, rtol=5e-3)
    assert linear.freq[0] == pytest.approx(exact[0], rel=5e-4)
    assert 8.0 < linear.freq[0] < 8.2  # where the recordings have it, before any calibration
    # Damping proportional to stiffness: zeta = beta omega/2, exactly.
    np.testing.assert_allclose(linear.zeta, 1.5e-4 * 2 * np.pi * linear.freq / 2, rtol=1e-6)


def test_the_links_follow_the_law_of_chains(rig):
    chain = build_chain(LENGTH, EI, links=8)
    hinges = [rig.new_data().joint(f"hinge{i + 1}").xanchor[0] for i in range(8)]
    np.testing.assert_allclose(hinges, chain.hinges, atol=1e-9)  # nine digits are written
    np.testing.assert_allclose(rig.model.jnt_stiffness, chain.stiffness, rtol=1e-8)
    assert rig.model.body_mass.sum() == pytest.approx(MU * LENGTH, rel=1e-8)
    assert rig.timestep < 2 / (2 * np.pi * rig.linearise().freq[-1])  # the explicit limit of the fastest mode


def test_gravity_acts_on_no_deflection(rig):
    rig.model.opt.gravity[2], weight = 0.0, rig.model.opt.gravity[2]
    without = rig.linearise().freq
    rig.model.opt.gravity[2] = weight
    np.testing.assert_allclose(rig.linearise().freq, without, rtol=1e-9)


def test_the_piezo_pair_is_the_moment_on_its_span(rig):
    data = rig.new_data()
    data.ctrl[0] = 1.0
    mujoco.mj_forward(rig.model, data)
    linear = rig.linearise()
    tip = rig.port_rows(["site:tip.y"])[0]
    # Static: the tip turns about the plates' middle by M span/EI; the two coefficients hold span and middle exactly.
    static = tip @ np.linalg.solve(linear.K, data.qfrc_actuator)
    assert static == pytest.approx(-MOMENT * 0.044 * (LENGTH - 0.036) / EI, rel=1e-6)
    # Modal: M (phi'(58 mm) - phi'(14 mm)) phi(L), with phi(L) = 2 in size. The curvature between two hinges is taken as
    # linear: 1 % of mode 1, 3 % of mode 2.
    shapes = linear.eigen[1][:, :2]
    for mode, tolerance in ((0, 0.01), (1, 0.03)):
        got = (shapes[:, mode] @ data.qfrc_actuator) * (tip @ shapes[:, mode])
        exact = MOMENT * (slope(BETA[mode], 0.058) - slope(BETA[mode], 0.014)) * 2 / (MU * LENGTH)
        assert abs(got) == pytest.approx(abs(exact), rel=tolerance)


def test_the_free_decay_case_runs_and_drifts_in_phase_only(rig):
    comparison = compare_case(asset("cases/avc_cantilever/free_decay.toml"), roles=("fit",))
    (run,) = comparison.runs
    (m,) = run.misfits
    assert run.simulation.initial.how == "estimated"
    # The state is found to within what 2 % of frequency do in two periods (pi x 2 x 0.02 x 2/sqrt(12) = 7 %).
    assert run.simulation.initial.nrmse < 0.1
    # 12 s are 98 periods: a frequency 2 % low turns the phase by two turns, so the error is as large as two sines.
    assert 1.0 < m.nrmse < 1.5
    within = np.searchsorted(m.band_edges_hz, [4.0, 12.0])
    assert m.band_share[within[0] - 1 : within[1]].sum() > 0.99  # all of it around the first mode
    document = json.loads(json.dumps(comparison.to_json(overlay=True), allow_nan=False))
    assert document["runs"][0]["overlay"][0]["unit"] == "m"
    assert len(document["runs"][0]["overlay"][0]["time_s"]) == len(run.measured)


@pytest.mark.slow
def test_the_amplifiers_limit_is_most_of_the_closed_loop_misfit(tmp_path):
    case = asset("cases/avc_cantilever/closed_loop_identified_observer.toml")
    for name in ("rig.xml", "experiment.mat"):
        (tmp_path / name).write_bytes(asset(f"cases/avc_cantilever/{name}").read_bytes())
    text = case.read_text().replace("\nK =", "\nlimit = 120.0\nK =")
    (tmp_path / "case.toml").write_text(text)
    ideal, limited = compare_case(case), compare_case(tmp_path)
    assert "memory at the start comes from the 845 samples before" in ideal.runs[0].simulation.notes[0]
    for name in ideal.nrmse:
        tip = [next(r for r in c.runs if r.run.name == name).misfits[0].nrmse for c in (ideal, limited)]
        # Measured .70/.73/.78 without and .31/.32/.34 with the limit (the rest: 2 % of frequency, gain, damping).
        assert tip[1] < 0.5 * tip[0]


def test_the_published_law_runs_too():
    case = load_case(asset("cases/avc_cantilever/closed_loop.toml"))
    assert [run.role for run in case.runs()] == ["fit", "holdout", "holdout"]
    assert case.runs()[0].law.controller.limit is None
