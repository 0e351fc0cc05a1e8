"""The beam's FE model: published tables, statics, invariances."""

import numpy as np
import pytest

from vlab.errors import BadStructure
from vlab.fe import SecondOrderModel, build_fe_model
from vlab.fe.one_mode import one_mode_bar
from vlab.fe.statics import cable_tensions, hanging_lines
from vlab.reproduce.tables.beam import TABLE_8
from vlab.reproduce.tables.registry import reproduce_tables
from vlab.reproduce.tables.structure import TABLE_1

LBF, INCH = 4.4482216152605, 0.0254


def test_the_published_model_has_nineteen_coordinates(fe):
    # section 2.1.1: nine points with two coordinates each, and the crosspiece
    assert fe.linear.n == 19
    assert fe.linear.coordinates[-1] == "tip:crosspiece"


@pytest.mark.parametrize(("number", "tolerance"), [("1", TABLE_1), ("8", TABLE_8)])
def test_published_tables_are_reproduced(number, tolerance):
    (table,) = reproduce_tables([number])
    for cell in table.cells:
        assert cell.ours == pytest.approx(cell.published, rel=tolerance), cell


def test_frequencies_converge_at_fourth_order(beam):
    reference = build_fe_model(beam, refine=16).linear.freq[:6]
    n = np.array([1, 2, 4])
    error = [np.abs(build_fe_model(beam, refine=int(k)).linear.freq[:6] / reference - 1).max() for k in n]
    # fourth order [Strang & Fix 1973, ch. 6]; the linear tension and rigid inserts are integrated exactly
    assert -np.polyfit(np.log(n), np.log(error), 1)[0] == pytest.approx(4.0, abs=0.3)


def test_tension_grows_with_the_weight_below(beam):
    line = hanging_lines(beam)["beam"]
    masses = sum(beam.point_mass(p.name) for p in beam.point)
    bars = sum(beam.section[b.section].mass_per_length * (80 if b.name == "beam" else 32) * INCH for b in beam.bar)
    upper = cable_tensions(beam)["cable-upper"]
    # equilibrium of everything that hangs between the two cables
    assert upper - cable_tensions(beam)["cable-lower"] == pytest.approx(beam.gravity * (masses + bars), rel=1e-12)
    assert line.tension(40 * INCH) < line.tension(60 * INCH) < upper


def test_crosspiece_alone_matches_its_identified_first_mode(beam):
    # identified from Tables 1, 7-9: 8.63 Hz, effective mass 2.202e-3 lb s^2/in, tip factor 1.164 (printed to 3-4 digits)
    mode = one_mode_bar(beam, "crosspiece")
    assert np.sqrt(mode.stiffness / mode.mass) / 2 / np.pi == pytest.approx(8.63, abs=0.005)
    assert mode.mass / (LBF / INCH) == pytest.approx(2.202e-3, abs=5e-7)
    assert mode.tip_factor == pytest.approx(1.164, abs=5e-4)
    assert mode.shape(16 * INCH) == pytest.approx(1.0)
    assert mode.shape(0.5 * INCH) == 0.0


def test_total_mass_is_carried_in_translation(beam):
    # a rigid translation of every point has the kinetic energy of the whole mass; exact for consistent mass
    for variant in ("published", "physical"):
        model = build_fe_model(beam, variant)
        rigid = np.array([1.0 if c.startswith(("v:", "tip:")) else 0.0 for c in model.linear.coordinates])
        bars = sum(beam.section[b.section].mass_per_length * (80 if b.name == "beam" else 32) * INCH for b in beam.bar)
        total = bars + sum(beam.point_mass(p.name) for p in beam.point)
        assert rigid @ model.linear.M @ rigid == pytest.approx(total, rel=1e-12)


def test_deflection_interpolates_the_points(fe):
    names = [p.name for p in fe.structure.point if p.name.endswith("in") or p.name in ("base", "top")]
    rows = fe.deflections(names)
    expected = np.array([[1.0 if c == f"v:{name}" else 0.0 for c in fe.linear.coordinates] for name in names])
    assert rows == pytest.approx(expected, abs=1e-12)
    middle = fe.deflection("35in") @ fe.linear.eigen[1][:, 0]
    ends = fe.deflections(["30in", "40in"]) @ fe.linear.eigen[1][:, 0]
    assert min(ends) < middle < max(ends)  # the first mode is monotonic there


def test_modal_damping_is_what_was_prescribed(fe, beam):
    assert fe.linear.zeta[:6] == pytest.approx(beam.damping.ratios, rel=1e-10)
    assert fe.linear.zeta[6:] == pytest.approx(beam.damping.higher, rel=1e-8)
    freq, zeta = fe.linear.complex_modes()
    assert freq == pytest.approx(
        fe.linear.freq, rel=1e-6
    )  # uncoupled modes: |s| is omega; eigenvalues of a 38-state matrix to rounding
    assert zeta == pytest.approx(fe.linear.zeta, rel=1e-5)


def test_measured_ratios_pass_over_modes_that_no_coil_drives(beam):
    model = build_fe_model(beam, "physical")
    silent = np.abs(model.coils.T @ model.linear.eigen[1]).max(axis=0) < 1e-6
    assert silent[2]  # the arms swing against each other at 8.63 Hz
    assert model.linear.freq[2] == pytest.approx(8.627, abs=0.002)
    assert model.linear.zeta[2] == pytest.approx(beam.damping.higher)
    assert model.linear.zeta[[0, 1, 3, 4, 5, 6]] == pytest.approx(beam.damping.ratios, rel=1e-8)


def test_python_control_gives_the_same_response(fe):
    system = fe.linear.state_space(fe.coils, fe.coils.T)
    freq = np.array([1.0, 5.3, 20.0])
    ours = fe.linear.frequency_response(freq, fe.coils, fe.coils.T).H
    theirs = np.array([system(2j * np.pi * f) for f in freq])
    assert ours == pytest.approx(theirs, rel=1e-6)  # two solvers on matrices of condition 1e10


def test_response_is_reciprocal_and_passive(fe):
    H = fe.linear.frequency_response(np.linspace(0.5, 60, 50), fe.coils, fe.coils.T).H
    assert pytest.approx(np.swapaxes(H, 1, 2), rel=1e-9) == H  # Maxwell-Betti
    for response in H:
        assert (
            np.linalg.eigvalsh((response + response.conj().T) / 2).min() > -1e-12 * np.abs(response).max()
        )  # collocated: no power comes out


def test_rate_feedback_only_dissipates(fe):
    gains = np.diag([3.0, 2.0, 1.0])
    damped = fe.linear.with_rate_feedback(fe.coils, gains)
    assert np.all(np.linalg.eigvals(damped.state_matrices(fe.coils, fe.coils.T)[0]).real < 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"M": np.diag([1.0, 0.0])}, "not positive definite"),
        ({"K": np.array([[1.0, 2.0], [0.0, 1.0]])}, "not symmetric"),
        ({"C": np.full((2, 2), np.nan)}, "not a finite 2 x 2"),
        ({"K": np.eye(3)}, "not a finite 2 x 2"),
    ],
)
def test_matrices_that_are_no_structure_are_refused(change, message):
    good = {"M": np.eye(2), "C": np.zeros((2, 2)), "K": np.eye(2)}
    with pytest.raises(BadStructure, match=message):
        SecondOrderModel(coordinates=("a", "b"), **(good | change))
