"""The recordings that come with vlab: every case loads, its nominal model misses by what it should, its numbers are right."""

import numpy as np
import pytest

from vlab.cases import compare_case, load_case
from vlab.design.published_tables import published_table
from vlab.files.assets import asset
from vlab.recordings import open_table

CASES = sorted(str(p.relative_to(asset("cases"))) for p in asset("cases").rglob("*.toml"))


def folder(name):
    return asset(f"cases/{name}")


def test_every_folder_says_where_it_comes_from():
    for path in asset("cases").iterdir():
        text = (path / "README.md").read_text()
        listed = [part for part in text.split("`") if "." in part]
        missing = [f.name for f in path.iterdir() if f.name not in ("README.md", "LICENSE") and f.name not in listed]
        assert not missing, path.name
        is_own = path.name == "dissertation"
        assert is_own or ("Origin" in text and (path / "LICENSE").stat().st_size > 1000), path.name
    assert sum(f.stat().st_size for f in asset("cases").rglob("*") if f.is_file()) < 3e6  # it is all in the package


@pytest.mark.parametrize("case", CASES)
def test_every_case_loads_and_its_recordings_fit_the_model(case):
    loaded = load_case(folder(case))
    assert loaded.table.title
    assert loaded.table.model.uncertain
    for run in loaded.runs():
        assert np.all(np.isfinite(run.measured.data))


# ---- positioning system ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_positioning_system_drifts_away_from_its_nominal_model():
    comparison = compare_case(folder("emps"))
    first, pulses = (run.misfits[0] for run in comparison.runs)
    # Open loop for 25 s: without dry friction and offset the model goes 1.5 times too far. The same equation by the
    # trapezoidal rule, without MuJoCo, leaves 1.637 and 1.699.
    assert first.nrmse == pytest.approx(1.637, rel=0.01)
    assert pulses.nrmse == pytest.approx(1.699, rel=0.01)
    assert [run.run.role for run in comparison.runs] == ["fit", "holdout"]


def slide(force, mass, viscous, coulomb, offset, step=1e-3):
    """Position of a mass with viscous and dry friction, trapezoidal in viscous friction, impulsive in dry friction."""
    x, v, out = 0.0, 0.0, np.empty(force.size)
    ahead, behind, dry = mass + step * viscous / 2, mass - step * viscous / 2, step * coulomb
    for k, f in enumerate(force.tolist()):
        out[k] = x
        p = behind * v + step * (f + offset)
        w = (p - np.clip(p, -dry, dry)) / ahead
        x, v = x + step * (v + w) / 2, w
    return out


def test_dry_friction_and_an_offset_are_what_the_positioning_system_lacks():
    left = {}
    for name in ("positioning", "positioning_pulses"):
        table = open_table(f"{name}.parquet", folder=folder("emps")).columns
        force, measured = 35.1507 * table["vir"], table["qm"]
        model = slide(force, 92.13, 189.9, 22.06, 3.372)
        left[name] = np.sqrt(np.mean((model - measured) ** 2)) / measured.std()
    # Fitted to the first recording by the same equation: 3.1 %, and 6.5 % on the other one. So scale, sign and units of
    # the case are right, and the pulses are in the voltage.
    assert left["positioning"] < 0.04
    assert left["positioning_pulses"] < 0.08


# ---- silverbox ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_silverbox_leaves_its_nominal_model_with_the_level():
    nrmse = compare_case(folder("silverbox")).nrmse
    # The same equation by a fixed-step fourth-order method on the mean of 27 periods, without MuJoCo, leaves .1153, .6755
    # and 1.1902; three periods in a row differ from that mean by their noise, and start from an estimated state.
    assert nrmse["20 mV"] == pytest.approx(0.1153, rel=0.02)
    assert nrmse["50 mV"] == pytest.approx(0.6755, rel=0.02)
    assert nrmse["100 mV"] == pytest.approx(1.1902, rel=0.02)


def oscillator(u, w2, damping, gain, k2, k3, fs, periods=2):
    """Last period of x'' + damping x' + w2 x + k2 x^2 + k3 x^3 = gain u by Runge-Kutta; u goes on linearly."""
    h, n = 1 / fs, u.size
    x = v = 0.0
    out, u = np.empty(n), u.tolist()

    def slope(x, v, f):
        return v, gain * f - damping * v - x * (w2 + x * (k2 + x * k3))

    for k in range(periods * n):
        out[k % n] = x
        a, b = u[k % n], u[(k + 1) % n]
        m = 0.5 * (a + b)
        x1, v1 = slope(x, v, a)
        x2, v2 = slope(x + h / 2 * x1, v + h / 2 * v1, m)
        x3, v3 = slope(x + h / 2 * x2, v + h / 2 * v2, m)
        x4, v4 = slope(x + h * x3, v + h * v3, b)
        x, v = x + h / 6 * (x1 + 2 * x2 + 2 * x3 + x4), v + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    return out


@pytest.mark.parametrize("level", [50, 100])
def test_quadratic_and_cubic_stiffness_are_what_the_silverbox_lacks(level):
    table = open_table(f"{level}mV.mat", folder=folder("silverbox")).columns
    u, y = (table[name].reshape(3, 8192).mean(axis=0) for name in ("um", "ym"))
    w2 = (2 * np.pi * 68.58) ** 2
    fitted = np.array([1.00535, 1.05845 * 40.0 / w2, 1.00790, -0.26603, 3.92717]) * w2  # README.md
    left = oscillator(u, *fitted, fs=2441.40625) - y
    # Fitted to 20 and 100 mV: 0.7 and 1.0 % were left, with 1 mV of offset (1 % of the rms) that is left out here.
    assert np.sqrt(np.mean(left**2)) < 0.02 * y.std()


# ---- three-storey frame ---------------------------------------------------------------------------------------------


def test_the_nominal_frame_is_a_uniform_chain_on_clamped_legs():
    leg = 12 * 70e9 * (0.025 * 0.003**3 / 12) / 0.1533**3
    exact = 2 * np.sqrt(4 * leg / 5.201) * np.sin(np.array([1, 3, 5]) * np.pi / 14) / (2 * np.pi)
    linear = load_case(folder("three_storey/southampton.toml")).plant.linearise()
    np.testing.assert_allclose(linear.freq, exact, rtol=1e-6)
    np.testing.assert_allclose(linear.freq, [7.11, 19.93, 28.80], atol=0.005)  # published
    np.testing.assert_allclose(linear.zeta[[0, 2]], 0.002, rtol=1e-4)


def test_the_frames_files_are_accelerances_of_the_floors_that_they_say():
    H = []
    for file, own in (("force_floor1.mat", "H1"), ("force_floor2.mat", "H2"), ("force_floor3.mat", "H3")):
        table = open_table(file, folder=folder("three_storey")).columns
        f = table["f"].ravel()
        assert (f[0], f[-1]) == (1.0, 60.0)
        response = {n: table[f"{n}_re"].ravel() + 1j * table[f"{n}_im"].ravel() for n in ("H1", "H2", "H3")}
        H.append([response[n] for n in ("H1", "H2", "H3")])
        low = f < 10
        assert f[low][np.abs(response[own][low]).argmax()] == pytest.approx(6.50, abs=0.04)
        # Above all modes a floor answers with its mass: within 15 % of the model's 1/m at 50 Hz.
        at = np.searchsorted(f, 50.0)
        assert response[own][at].real == pytest.approx(1.2 / 5.201, rel=0.15)
        others = [n for n in response if n != own]
        assert all(abs(response[n][at]) < 0.2 * abs(response[own][at]) for n in others)
    H = np.array(H)
    band = (f > 4) & (f < 30)
    # Reciprocity; the resonances are as narrow as a line, so their peaks differ by some per cent.
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.linalg.norm((H[i, j] - H[j, i])[band]) < 0.25 * np.linalg.norm(H[i, j][band])


def test_the_swansea_frame_has_the_frequencies_of_its_readme():
    table = open_table("swansea.csv", folder=folder("three_storey")).columns
    f = table["f"]
    for low, high, expected in ((5, 10, 7.00), (15, 22, 19.38), (25, 33, 29.12)):
        part = (f > low) & (f < high)
        peak = f[part][(table["H1"] + table["H2"] + table["H3"])[part].argmax()]
        assert peak == pytest.approx(expected, abs=0.13)  # one line


# ---- cantilever -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_laser_stops_where_the_other_sensors_go_on():
    comparison = compare_case(folder("avc_cantilever/capacitive.toml"))
    run = next(r for r in comparison.runs if r.run.name == "release 3")
    measured = run.measured
    stopped = np.abs(measured["laser"]) >= 0.015 - 1e-6
    np.testing.assert_allclose(measured.time[stopped], [25.43, 25.44, 25.50], atol=1e-6)
    assert np.abs(measured["plate3"]).max() > 0.02
    # The model is 2 % low in frequency and its damping and gain are guesses: 20 periods later the phase is off by 2.5 rad.
    assert all(0.8 < m.nrmse < 1.2 for r in comparison.runs for m in r.misfits)
    later = measured.time > 25.6
    ratio = np.linalg.norm(measured["laser"][later]) / np.linalg.norm(measured["capacitive"][later])
    assert ratio == pytest.approx(1.0, abs=0.05)  # both in mm at the tip


# ---- dissertation ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("structure", "number"), [("beam", "1"), ("grid", "3")])
def test_the_dissertations_cases_are_its_tables(structure, number):
    case = load_case(folder(f"dissertation/{structure}_table{number}.toml"))
    (modal,) = case.table.modal
    table = published_table(structure, number)
    assert case.table.model.structure == structure
    np.testing.assert_array_equal(modal.frequency_hz, table.column("experimental"))
    np.testing.assert_array_equal(modal.zeta, table.column("damping ratio, experimental"))
