"""Baruch's correction: closed forms, reproduction, minimal change, the beam against its own full model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vlab.errors import BadRecording, BadStructure, UnknownName
from vlab.fe import SecondOrderModel
from vlab.fe.correction import (
    correct_damping,
    correct_mass,
    correct_model,
    correct_sequentially,
    correct_stiffness,
    normalise_shapes,
)
from vlab.fe.reduction import exact_reduction, guyan_reduction
from vlab.signals import ModalModel

law = settings(derandomize=True, max_examples=20, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def definite(rng, n, low, high):
    """Random matrix with eigenvalues between low and high, so that the condition is known."""
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (Q * np.geomspace(low, high, n)) @ Q.T


def random_model(rng, n):
    """Random mass of condition 10 and stiffness of condition 1e3, with modal damping."""
    model = SecondOrderModel(
        M=definite(rng, n, 1.0, 10.0),
        C=np.zeros((n, n)),
        K=definite(rng, n, 1e3, 1e6),
        coordinates=tuple(f"q{i}" for i in range(n)),
    )
    return model.with_modal_damping(rng.uniform(0.001, 0.05, n))


def random_test(seed, *, noise=0.15):
    """Random model, and modes of it with other frequencies, ratios, scales and noisy shapes, in another order of rows."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 12))
    model, count = random_model(rng, n), int(rng.integers(1, n + 1))
    modes = np.sort(rng.permutation(n)[:count])
    shapes = model.eigen[1][:, modes]
    shapes = shapes + noise * np.abs(shapes).max(axis=0) * rng.uniform(-1, 1, shapes.shape) / np.sqrt(n)
    rows = rng.permutation(n)
    measured = ModalModel(
        freq=model.freq[modes] * rng.uniform(0.8, 1.2, count),
        zeta=rng.uniform(0.001, 0.1, count),
        shapes=(shapes * rng.choice([-3.0, 0.2, 40.0], count))[rows],
        coordinates=tuple(model.coordinates[i] for i in rows),
    )
    return model, measured, rng


def size(matrix, model):
    """The norm that Baruch minimises, |M^-1/2 (.) M^-1/2|."""
    return np.linalg.norm(model.eigen[1].T @ matrix @ model.eigen[1])


def as_measured(model, full, count, rows):
    """The first modes of the full model, seen at the coordinates of the reduced one."""
    return ModalModel(
        freq=full.freq[:count],
        zeta=full.zeta[:count],
        shapes=full.eigen[1][rows, :count],
        coordinates=model.coordinates,
    )


@pytest.fixture(scope="module")
def beam_guyan(fe):
    return guyan_reduction(fe.linear, [c for c in fe.linear.coordinates if c.startswith(("v:", "tip:"))])


# closed forms


def test_two_masses_and_two_oblique_shapes_have_a_closed_form():
    # M = I and unit vectors at the angle a: Phi^T M Phi = [[1, c], [c, 1]]; as many shapes as coordinates fix all
    c, s = np.cos(1.2), np.sin(1.2)
    shapes = np.array([[1.0, c], [0.0, s]])
    phi = normalise_shapes(shapes * [5.0, -0.1], np.eye(2))
    assert phi == pytest.approx(shapes * [1, -1], abs=1e-15)  # (3.17); signs are kept
    inverse = np.linalg.inv(phi)
    mass = correct_mass(np.eye(2), phi)
    assert mass == pytest.approx(inverse.T @ inverse, rel=1e-13)  # a 2 x 2 inverse
    omega = 2 * np.pi * np.array([3.0, 1.0])
    stiffness = correct_stiffness(np.diag([7.0, 8.0]), mass, phi, [3.0, 1.0])
    expected = (inverse.T * omega**2) @ inverse
    assert stiffness == pytest.approx(expected, rel=1e-12)  # whatever K was
    damping = correct_damping(mass, stiffness, phi, [3.0, 1.0], [0.1, 0.2], zeta_rest=[])
    expected = (phi * (2 * np.array([0.1, 0.2]) * omega)) @ inverse
    assert np.linalg.solve(mass, damping) == pytest.approx(expected, rel=1e-12)  # (3.20)


def test_a_shape_that_is_a_mode_changes_one_frequency_only():
    model = SecondOrderModel(
        M=np.diag([2.0, 1.0, 4.0]), C=np.zeros((3, 3)), K=np.diag([2.0, 9.0, 64.0]), coordinates=("a", "b", "c")
    ).with_modal_damping([0.01, 0.02, 0.03])
    test = ModalModel(freq=[2.5], zeta=[0.5], shapes=[[0.0], [-7.0], [0.0]], coordinates=("a", "b", "c"))
    correction = correct_model(model, test)
    omega = 5 * np.pi
    # diagonal matrices stay diagonal: a few roundings
    assert np.array_equal(correction.model.M, model.M)
    assert correction.mass_change == 0
    assert pytest.approx(np.diag([2.0, omega**2, 64.0]), rel=1e-14) == correction.model.K
    assert pytest.approx(np.diag([2 * 0.01 * 2, 2 * 0.5 * omega, 2 * 0.03 * 4 * 4]), rel=1e-13) == correction.model.C
    assert correction.stiffness_change == pytest.approx((omega**2 - 9) / np.sqrt(1 + 81 + 256), rel=1e-12)
    assert list(correction.origin) == [1]
    assert list(correction.others) == [0, 2]
    assert correction.tracked * 2 * np.pi == pytest.approx([1.0, omega, 4.0], rel=1e-13)
    assert correction.off_diagonal == (0.0, 0.0)


@law
@given(seeds)
def test_as_many_modes_as_coordinates_leave_nothing_of_the_model(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    model, other = random_model(rng, n), random_model(rng, n)
    measured = ModalModel(freq=other.freq, zeta=other.zeta, shapes=other.eigen[1], coordinates=other.coordinates)
    corrected = correct_model(model, measured).model
    # the other model up to the scale of its modal masses, which a test of shapes cannot tell; condition 10 of each mass
    phi = normalise_shapes(other.eigen[1], model.M)
    inverse = np.linalg.inv(phi)
    assert pytest.approx(inverse.T @ inverse, abs=1e-10 * np.abs(inverse.T @ inverse).max()) == corrected.M
    modal = phi @ np.diag(2 * other.zeta * 2 * np.pi * other.freq) @ inverse
    assert np.linalg.solve(corrected.M, corrected.C) == pytest.approx(modal, abs=1e-9 * np.abs(modal).max())


# laws


@law
@given(seeds)
def test_measured_modes_become_modes(seed):
    model, measured, _ = random_test(seed)
    correction = correct_model(model, measured)
    new, phi = correction.model, correction.shapes
    omega = 2 * np.pi * measured.freq
    # two solves with the orthogonality matrix, condition up to 1e3 with this noise, on matrices of condition 1e4
    assert phi.T @ new.M @ phi == pytest.approx(np.eye(omega.size), abs=1e-9)
    assert new.K @ phi == pytest.approx(new.M @ phi * omega**2, abs=1e-9 * np.abs(new.K).max())
    assert new.C @ phi == pytest.approx(new.M @ phi * 2 * measured.zeta * omega, abs=1e-9 * np.abs(new.C).max())
    found = np.array([np.abs(new.freq / f - 1).min() for f in measured.freq])
    assert found == pytest.approx(np.zeros(omega.size), abs=1e-9)
    # the scale and the order of rows and columns of what was measured do not matter
    scaled = phi / np.abs(phi).max(axis=0)
    given_shapes = measured.shapes[[measured.coordinates.index(c) for c in model.coordinates]]
    given_shapes = given_shapes / np.abs(given_shapes).max(axis=0)
    assert scaled == pytest.approx(given_shapes, abs=1e-12)  # two divisions


@law
@given(seeds)
def test_corrected_matrices_are_those_of_a_structure(seed):
    model, measured, _ = random_test(seed, noise=0.5)  # poor shapes too
    new = correct_model(model, measured).model
    for name in ("M", "C", "K"):
        matrix = getattr(new, name)
        assert np.array_equal(matrix, matrix.T)
        # each is a sum of squares: positive up to the rounding of its largest entry
        assert np.linalg.eigvalsh(matrix).min() > -1e-9 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(new.M).min() > 0


@law
@given(seeds)
def test_correcting_again_changes_nothing(seed):
    model, measured, _ = random_test(seed)
    once = correct_model(model, measured)
    twice = correct_model(once.model, measured)
    for name in ("M", "C", "K"):
        expected = getattr(once.model, name)
        assert getattr(twice.model, name) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert twice.mass_change < 1e-9
    assert twice.stiffness_change < 1e-9
    assert twice.damping_change < 1e-9
    assert twice.orthogonality == pytest.approx(np.eye(measured.freq.size), abs=1e-9)


@law
@given(seeds)
def test_a_models_own_modes_correct_nothing(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(2, 12)))
    count = int(rng.integers(1, model.n + 1))
    correction = correct_model(model, as_measured(model, model, count, range(model.n)))
    # rounding of eigenvectors of condition 1e4
    assert correction.mass_change < 1e-11
    assert correction.stiffness_change < 1e-10
    assert correction.damping_change < 1e-10
    assert list(correction.origin) == list(range(count))
    assert correction.shift == pytest.approx(np.zeros(model.n), abs=1e-8 * model.freq[-1])


@law
@given(seeds)
def test_no_other_change_is_smaller(seed):
    # Pythagoras: whatever keeps the measured modes is orthogonal to the change, in the norm that is minimised
    model, measured, rng = random_test(seed)
    correction = correct_model(model, measured)
    new, phi = correction.model, correction.shapes
    for before, after, weight in ((model.M, new.M, model), (model.K, new.K, new)):
        other = rng.normal(size=(model.n, model.n)) * np.abs(before).max()
        P = np.eye(model.n) - phi @ phi.T @ new.M
        other = P.T @ (other + other.T) @ P  # P phi = 0: neither orthonormality nor a mode changes
        if weight is model:  # the mass only has to keep phi^T M phi: off the block of the measured modes all is free
            free = rng.normal(size=(phi.shape[1], model.n)) * np.abs(before).max()
            other = other + new.M @ phi @ free @ P + (new.M @ phi @ free @ P).T
        change = size(after - before, weight)
        total = size(after - before + other, weight)
        # rounding of matrices of condition 1e4 only
        assert total**2 == pytest.approx(change**2 + size(other, weight) ** 2, rel=1e-8)


@law
@given(seeds)
def test_the_stiffness_is_equation_3_19_with_the_corrected_mass_at_its_end(seed):
    model, measured, _ = random_test(seed)
    correction = correct_model(model, measured)
    k, m, p = model.K, correction.model.M, correction.shapes
    kept = k - k @ p @ p.T @ m - m @ p @ p.T @ k + m @ p @ p.T @ k @ p @ p.T @ m
    omega2 = np.diag((2 * np.pi * measured.freq) ** 2)
    assert pytest.approx(kept + m @ p @ omega2 @ p.T @ m, abs=1e-10 * np.abs(k).max()) == correction.model.K


def test_equation_3_19_as_printed_is_no_stiffness():
    model, measured, _ = random_test(6, noise=0.5)
    correction = correct_model(model, measured)
    assert measured.freq.size > 1  # one mode leaves the mass as it is, and hides the misprint
    k, m, p = model.K, correction.model.M, correction.shapes
    printed = k - k @ p @ p.T @ m - m @ p @ p.T @ k + m @ p @ p.T @ k @ p @ p.T @ m
    printed = printed + m @ p @ np.diag((2 * np.pi * measured.freq) ** 2) @ p.T @ model.M
    assert np.abs(printed - printed.T).max() > 1e-3 * np.abs(printed).max()


@law
@given(seeds)
def test_unmeasured_modes_keep_their_ratios_and_nothing_couples(seed):
    model, measured, _ = random_test(seed)
    correction = correct_model(model, measured)
    new = correction.model
    modal = new.eigen[1].T @ new.C @ new.eigen[1]
    # eigenvectors of condition 1e4; modes that come within 1e-5 of each other could mix and are left out
    if np.diff(new.freq).min() > 1e-5 * new.freq[-1]:
        assert modal == pytest.approx(np.diag(np.diag(modal)), abs=1e-7 * np.abs(modal).max())
        assert sorted(new.zeta) == pytest.approx(sorted([*measured.zeta, *model.zeta[correction.others]]), rel=1e-6)


@law
@given(seeds)
def test_units_of_the_coordinates_do_not_matter(seed):
    model, measured, rng = random_test(seed)
    units = 10.0 ** rng.integers(-2, 3, model.n)  # q = diag(units) p
    rows = [model.coordinates.index(c) for c in measured.coordinates]
    one = correct_model(model, measured)
    other = correct_model(
        model.transformed(np.diag(units), model.coordinates),
        ModalModel(
            freq=measured.freq,
            zeta=measured.zeta,
            shapes=measured.shapes / units[rows, None],
            coordinates=measured.coordinates,
        ),
    )
    # condition 1e4 of the matrices, and 1e8 more of bad scaling that the factorisations see through only in part
    assert other.mass_change == pytest.approx(one.mass_change, rel=1e-6, abs=1e-8)
    assert other.stiffness_change == pytest.approx(one.stiffness_change, rel=1e-6, abs=1e-8)
    assert other.model.freq == pytest.approx(one.model.freq, rel=1e-6)


# sequential


@law
@given(seeds)
def test_sequential_correction_is_independent_of_the_path(seed):
    model, measured, _ = random_test(seed)
    steps = correct_sequentially(model, measured)
    assert len(steps) == measured.freq.size
    assert steps[0].mass_change < 1e-12  # one shape is normalised by the mass: nothing is left to correct
    M, K = model.M, model.K
    for k, step in enumerate(steps, start=1):
        # from the step before, with shapes of the same scale; two solves of condition 1e3 at each of up to 11 steps
        phi = step.shapes
        M = correct_mass(M, phi)
        K = correct_stiffness(K, M, phi, measured.freq[:k])
        assert pytest.approx(M, abs=1e-8 * np.abs(M).max()) == step.model.M
        assert pytest.approx(K, abs=1e-8 * np.abs(K).max()) == step.model.K
        assert sorted(step.tracked) == pytest.approx(step.model.freq, rel=1e-8)
        assert step.tracked[step.origin] == pytest.approx(measured.freq[:k], rel=1e-12)
    assert steps[-1].model.M.tobytes() == correct_model(model, measured).model.M.tobytes()


def test_correcting_the_beams_guyan_model_disturbs_no_higher_mode(fe, beam_guyan):
    # section 3.3: each further mode leaves the higher frequencies as they were or improves them
    true = fe.linear.freq[:10]
    measured = as_measured(beam_guyan.model, fe.linear, 10, list(beam_guyan.retained))
    errors = [np.abs(beam_guyan.model.freq / true - 1)]
    for k, step in enumerate(correct_sequentially(beam_guyan.model, measured), start=1):
        assert list(step.origin) == list(range(k))
        errors.append(np.abs(step.tracked / true - 1))
        assert np.all(errors[-1][:k] < 1e-11)  # eigenvalues that span 2e3
        assert np.all(errors[-1][k:] <= errors[-2][k:] + 1e-11)
    assert errors[0][-1] > 0.03  # what there was to correct


# the beam


def test_the_beams_guyan_model_gets_the_modes_of_the_full_model(fe, beam_guyan):
    rows = list(beam_guyan.retained)
    correction = correct_model(beam_guyan.model, as_measured(beam_guyan.model, fe.linear, 6, rows))
    # eigenvalues that span 2e3
    assert correction.model.freq[:6] == pytest.approx(fe.linear.freq[:6], rel=1e-11)
    assert correction.model.zeta[:6] == pytest.approx(fe.linear.zeta[:6], rel=1e-9)
    assert correction.model.zeta[6:] == pytest.approx(beam_guyan.model.zeta[6:], rel=1e-9)
    # Guyan loses 0.2 % of the sixth frequency: as small are the changes
    assert correction.mass_change < 0.005
    assert correction.stiffness_change < 0.005
    assert correction.off_diagonal[0] < 0.005


def test_all_measured_modes_make_guyans_model_the_exact_reduction(fe, beam_guyan):
    # with as many modes as coordinates nothing of Guyan's model is left but the scale of the shapes
    rows = list(beam_guyan.retained)
    corrected = correct_model(beam_guyan.model, as_measured(beam_guyan.model, fe.linear, 10, rows)).model
    exact = exact_reduction(fe.linear, rows).model
    for name in ("C", "K"):
        expected = np.linalg.solve(exact.M, getattr(exact, name))
        ours = np.linalg.solve(corrected.M, getattr(corrected, name))
        assert ours == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())  # condition 2e3


# labels


def test_coordinates_are_matched_by_label_or_by_mapping():
    model, measured, _ = random_test(11)
    by_label = correct_model(model, measured)
    mapping = {f"sensor:{name}": name for name in measured.coordinates}
    other = ModalModel(
        freq=measured.freq,
        zeta=measured.zeta,
        shapes=np.vstack([measured.shapes, np.full((1, measured.freq.size), 9.0)]),
        coordinates=(*mapping, "sensor:spare"),
    )
    by_mapping = correct_model(model, other, coordinates=mapping)
    assert by_mapping.model.K.tobytes() == by_label.model.K.tobytes()


# what is refused


def three(**change):
    given_ = {
        "freq": [1.0, 2.0],
        "zeta": [0.01, 0.01],
        "shapes": [[1.0, 1.0], [1.0, 0.0], [1.0, -1.0]],
        "coordinates": ("a", "b", "c"),
    }
    return ModalModel(**(given_ | change))


@pytest.mark.parametrize(
    ("change", "mapping", "error", "message"),
    [
        (
            {"shapes": [[1.0, 1.0], [1.0, 0.0]], "coordinates": ("a", "b")},
            None,
            BadRecording,
            "not measured: c; reduce",
        ),
        (
            {"coordinates": ("a", "b", "cc")},
            None,
            UnknownName,
            "unknown coordinate of the model 'cc'; did you mean 'c'",
        ),
        ({"coordinates": ("a", "b", "b")}, None, BadRecording, "'b' stands 2 times"),
        ({}, {"a": "a", "b": "b", "d": "c"}, UnknownName, "unknown measured coordinate 'd'"),
        ({}, {"a": "a", "b": "b"}, BadRecording, "not measured: c"),
        ({}, {"a": "a", "b": "b", "c": "b"}, BadRecording, "'b' and 'c' are both mapped to .* 'b'"),
        ({"shapes": [[1, 1], [1, np.nan], [1, -1]]}, None, BadRecording, "measured mode 1 is nan at coordinate 1"),
        ({"shapes": [[0, 1], [0, 0], [0, -1]]}, None, BadRecording, "measured mode 0 is zero everywhere"),
        ({"shapes": [[1, -2], [1, -2], [1, -2]]}, None, BadRecording, "measured modes 0, 1 are linearly dependent"),
        ({"shapes": [[1, 1], [1, 1j], [1, -1]]}, None, BadRecording, "complex; the correction needs real ones"),
        ({"freq": [1.0, np.nan]}, None, BadRecording, "frequencies of mode 1 is nan"),
        ({"freq": [1.0, -2.0]}, None, BadRecording, "mode 1 has the frequency -2 Hz"),
        ({"zeta": [np.inf, 0.0]}, None, BadRecording, "damping ratios of mode 0 is inf"),
        (
            {"freq": range(1, 5), "zeta": [0.1] * 4, "shapes": np.eye(3, 4) + 1},
            None,
            BadRecording,
            "4 measured modes for a model of 3 coordinates",
        ),
        ({"freq": [], "zeta": [], "shapes": np.empty((3, 0))}, None, BadRecording, "0 measured modes"),
    ],
)
@pytest.mark.parametrize("correct", [correct_model, correct_sequentially])
def test_measurements_that_cannot_correct_are_refused(correct, change, mapping, error, message):
    model = SecondOrderModel(M=np.eye(3), C=np.zeros((3, 3)), K=np.diag([1.0, 2, 3]), coordinates=("a", "b", "c"))
    with pytest.raises(error, match=message):
        correct(model, three(**change), coordinates=mapping)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: normalise_shapes(np.ones((2, 1)), np.eye(3)), BadRecording, "do not fit a mass matrix of"),
        (lambda: normalise_shapes(np.ones(3), np.eye(3)), BadRecording, "one row a coordinate"),
        (lambda: normalise_shapes(np.ones((2, 1)), np.diag([1.0, -1.0])), BadStructure, "not positive definite"),
        (lambda: normalise_shapes(np.ones((2, 1)), np.ones((2, 3))), BadStructure, "not a finite square matrix"),
        (lambda: normalise_shapes(np.ones((2, 1)), np.triu(np.ones((2, 2)))), BadStructure, "not symmetric"),
        (lambda: correct_stiffness(np.eye(3), np.eye(2), [[1.0], [0]], [1]), BadStructure, "not a finite 2 x 2"),
        (lambda: correct_stiffness(np.eye(2), np.eye(2), [[1.0], [0]], [1, 2]), BadRecording, "do not fit 1 modes"),
        (lambda: correct_stiffness(np.eye(2), np.eye(2), [[2.0], [0]], [1]), BadRecording, "call correct_mass first"),
        (
            lambda: correct_damping(np.eye(2), np.eye(2), [[1.0], [0]], [1], [0.1], zeta_rest=[0.1, 0.2]),
            BadRecording,
            "damping ratios of the rest of shape",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()
