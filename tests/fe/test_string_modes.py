"""The cables' own vibration: against the textbook string and a mesh of it."""

import itertools

import numpy as np
import pytest
from scipy import linalg

from vlab.errors import BadStructure, UnknownName
from vlab.fe import build_fe_model
from vlab.fe.statics import cable_tensions
from vlab.fe.string_modes import add_string_modes, string_frequency, string_shares, with_cable_mass


def test_a_string_has_the_textbook_frequencies(beam):
    cable = next(c for c in beam.cable if c.name == "cable-lower")
    along = cable_tensions(beam)["cable-lower"] / 2 * cable.length / abs(cable.height)
    first = np.sqrt(along / (cable.density * cable.area)) / (2 * cable.length)
    assert string_frequency(beam, "cable-lower") == pytest.approx(first, rel=1e-12)
    assert string_frequency(beam, "cable-lower", 3) == pytest.approx(3 * first, rel=1e-12)
    assert string_frequency(with_cable_mass(beam, "cable-lower", 0.25), "cable-lower") == pytest.approx(
        2 * first, rel=1e-12
    )


def test_the_strings_lie_where_the_wire_puts_them(beam):
    # solid wire, identified beforehand: 32.8 and 45.9 Hz. The spread of the fixings is assumed, and length goes with it
    lower, upper = (string_frequency(beam, f"cable-{end}") for end in ("lower", "upper"))
    assert lower == pytest.approx(32.8, rel=0.035)
    assert upper == pytest.approx(45.9, rel=0.035)


def test_own_modes_converge_to_a_mesh_of_the_cables(beam, fe):
    # the same beam with each cable set as a chain of linear string elements instead of spring and end mass
    tensions = cable_tensions(beam)
    parts = 200
    n = fe.linear.n
    M, K = (linalg.block_diag(X, np.zeros((2 * (parts - 1),) * 2)) for X in (fe.linear.M, fe.linear.K))
    for i, cable in enumerate(beam.cable):
        row, stiffness, mass = fe.deflection(cable.at), tensions[cable.name] / abs(cable.height), 3 * cable.end_mass
        M[:n, :n] -= mass / 3 * np.outer(row, row)
        K[:n, :n] -= stiffness * np.outer(row, row)
        inner = [np.eye(len(M))[n + i * (parts - 1) + k] for k in range(parts - 1)]
        end = np.concatenate([row, np.zeros(len(M) - n)])
        nodes = [np.zeros(len(M)), *inner, end]
        for a, b in itertools.pairwise(nodes):
            both = np.array([a, b])
            M += both.T @ (mass / parts / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])) @ both
            K += both.T @ (stiffness * parts * np.array([[1.0, -1.0], [-1.0, 1.0]])) @ both
    mesh = np.sqrt(linalg.eigh(K, M, eigvals_only=True)[:16]) / (2 * np.pi)
    errors = [np.abs(add_string_modes(fe, count).linear.freq[:12] / mesh[:12] - 1).max() for count in (1, 4, 8)]
    assert errors[0] > 0.1  # the twelfth mode is the lower cable's second: one own mode each cannot have it
    assert errors[1] > errors[2]
    assert errors[2] < 1e-4  # 200 linear elements are (2 pi/200)^2/24 = 4e-5 stiff there


def test_the_structures_first_modes_stay(fe):
    wider = add_string_modes(fe)
    assert wider.linear.freq[:6] == pytest.approx(
        fe.linear.freq[:6], rel=6e-3
    )  # mode 6 is pushed down by the string above it
    assert wider.linear.zeta[:6] == pytest.approx(fe.linear.zeta[:6], rel=0.02)
    assert wider.linear.coordinates[-2:] == ("s1:cable-upper", "s1:cable-lower")
    assert wider.deflection("30in")[: fe.linear.n] == pytest.approx(fe.deflection("30in"), abs=0)


def test_shares_of_energy_single_out_the_strings(fe):
    shares = string_shares(add_string_modes(fe))
    assert np.count_nonzero(shares > 0.5) == 2
    assert shares.sum() == pytest.approx(
        2.0, abs=0.2
    )  # mass-normalised modes hold each coordinate's own mass once, less its coupling
    assert np.array_equal(string_shares(fe), np.zeros(fe.linear.n))


def test_damping_of_a_string_is_as_asked(fe):
    light, heavy = (add_string_modes(fe, zeta=zeta).linear for zeta in (1e-4, 1e-2))
    mode = int(string_shares(add_string_modes(fe)).argmax())
    assert light.zeta[mode] < 3e-4  # what the beam adds to it
    assert heavy.zeta[mode] == pytest.approx(1e-2, rel=0.1)


def test_what_makes_no_sense_is_refused(beam, fe):
    with pytest.raises(BadStructure, match="from 1 mode"):
        add_string_modes(fe, 0)
    with pytest.raises(BadStructure, match="above 0"):
        with_cable_mass(beam, "cable-lower", 0.0)
    with pytest.raises(UnknownName, match="unknown cable 'cable'"):
        string_frequency(beam, "cable")
    assert build_fe_model(with_cable_mass(beam, "cable-lower", 0.62)).linear.n == fe.linear.n
