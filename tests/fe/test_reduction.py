"""Exact reduction, Guyan's reduction and the search for coordinates: closed forms, identities, the beam."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vlab.errors import BadStructure, UnknownName
from vlab.fe import SecondOrderModel
from vlab.fe.reduction import exact_reduction, guyan_reduction, search_retained

seeds = st.integers(0, 2**32 - 1)
law = settings(derandomize=True, max_examples=25, deadline=None)


def chain(n, *, is_free=False):
    """Equal masses 1 kg between equal springs 1 N/m, held at both ends or free."""
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    if is_free:
        K[0, 0] = K[-1, -1] = 1.0
    return SecondOrderModel(M=np.eye(n), C=np.zeros((n, n)), K=K, coordinates=tuple(f"v{i + 1}" for i in range(n)))


def definite(rng, n, low, high):
    """Random matrix with eigenvalues between low and high, so that the condition is known."""
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (Q * np.geomspace(low, high, n)) @ Q.T


def random_model(seed):
    """Random model of 3 to 12 coordinates, its damping coupling the modes, and some of its rows in random order."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 13))
    model = SecondOrderModel(
        M=definite(rng, n, 1.0, 30.0),
        C=definite(rng, n, 0.1, 10.0),
        K=definite(rng, n, 1e3, 1e6),
        coordinates=tuple(f"q{i}" for i in range(n)),
    )
    return model, [int(i) for i in rng.permutation(n)[: rng.integers(1, n)]], rng


def exactly_reducible(seed):
    """Like `random_model`, and as many modes that the rows can carry: the result of a reduction of fair condition."""
    for attempt in itertools.count(seed):
        model, keep, rng = random_model(attempt)
        reduction = exact_reduction(model, keep)
        if reduction.condition < 100:
            return model, keep, reduction, rng
    raise AssertionError


def translations(fe):
    return [name for name in fe.linear.coordinates if name.startswith(("v:", "tip:"))]


# Guyan


def test_the_tip_of_one_beam_element_carries_33_of_140_of_its_mass():
    # clamped Bernoulli beam, EI = rho A = L = 1: Rayleigh's quotient of the static deflection, 3 EI / (33/140 rho A L^4)
    element = SecondOrderModel(
        M=np.array([[156.0, -22.0], [-22.0, 4.0]]) / 420,
        C=np.zeros((2, 2)),
        K=np.array([[12.0, -6.0], [-6.0, 4.0]]),
        coordinates=("v", "r"),
    )
    reduction = guyan_reduction(element, ["v"])
    assert pytest.approx(np.array([[1.0], [1.5]]), rel=1e-14) == reduction.T  # a few roundings
    assert reduction.model.K[0, 0] == pytest.approx(3.0, rel=1e-14)
    assert reduction.model.M[0, 0] == pytest.approx(33 / 140, rel=1e-13)


def test_a_chain_of_three_masses_condenses_in_closed_form():
    outer = guyan_reduction(chain(3), ["v1", "v3"])
    assert pytest.approx(np.array([[1.5, -0.5], [-0.5, 1.5]]), rel=1e-14) == outer.model.K  # a few roundings
    assert pytest.approx(np.array([[1.25, 0.25], [0.25, 1.25]]), rel=1e-14) == outer.model.M
    # the middle mass rests in the antisymmetric mode, which is therefore exact: 2 k/m
    assert (2 * np.pi * outer.model.freq) ** 2 == pytest.approx([2 / 3, 2.0], rel=1e-13)
    middle = guyan_reduction(chain(3), ["v2"])
    assert (middle.model.K[0, 0], middle.model.M[0, 0]) == pytest.approx((1.0, 1.5), rel=1e-14)


@law
@given(seeds)
def test_guyan_keeps_the_static_response_to_any_load(seed):
    model, keep, rng = random_model(seed)
    reduction = guyan_reduction(model, keep)
    loads = rng.normal(size=(model.n, 3))
    full = np.linalg.solve(model.K, loads)[keep]
    reduced = np.linalg.solve(reduction.model.K, reduction.reduce_loads(loads))
    # condition of K is 1e3: rounding to 1e-13 of the largest deflection anywhere
    assert reduced == pytest.approx(full, abs=1e-10 * np.abs(np.linalg.solve(model.K, loads)).max())


@law
@given(seeds)
def test_guyan_frequencies_interlace_the_true_ones_from_above(seed):
    model, keep, _ = random_model(seed)
    reduced = guyan_reduction(model, keep).model.freq
    # Cauchy: a Ritz subspace of n_R dimensions; eigenvalues of condition 3e4 round to 1e-11 of the lowest
    assert np.all(reduced >= model.freq[: len(keep)] * (1 - 1e-10))
    assert np.all(reduced <= model.freq[-len(keep) :] * (1 + 1e-10))


@law
@given(seeds)
def test_the_matrices_are_the_equations_without_misprints(seed):
    model, keep, _ = random_model(seed)
    rest = [i for i in range(model.n) if i not in keep]
    M11, M12, M22 = (model.M[np.ix_(*ij)] for ij in ((keep, keep), (keep, rest), (rest, rest)))
    K11, K12, K22 = (model.K[np.ix_(*ij)] for ij in ((keep, keep), (keep, rest), (rest, rest)))
    G0 = -np.linalg.solve(K22, K12.T)  # (3.15)
    reduced = guyan_reduction(model, keep).model
    # Schur complement of condition 1e3
    assert pytest.approx(K11 - K12 @ np.linalg.solve(K22, K12.T), abs=1e-11 * np.abs(model.K).max()) == reduced.K
    M_R = M11 + M12 @ G0 + G0.T @ M12.T + G0.T @ M22 @ G0  # (3.16)
    assert pytest.approx(M_R, rel=1e-9) == reduced.M  # |G0| up to 30


@law
@given(seeds)
def test_condensing_twice_is_condensing_once(seed):
    model, keep, _ = random_model(seed)
    once = guyan_reduction(model, keep)
    between = guyan_reduction(model, range(model.n - 1) if model.n - 1 not in keep else range(model.n))
    twice = guyan_reduction(between.model, [model.coordinates[i] for i in keep])
    for name in ("M", "C", "K"):
        expected = getattr(once.model, name)
        assert getattr(twice.model, name) == pytest.approx(
            expected, abs=1e-10 * np.abs(expected).max()
        )  # condition 1e3


@law
@given(seeds)
def test_neither_order_nor_units_of_the_coordinates_matter(seed):
    model, keep, rng = random_model(seed)
    units = 10.0 ** rng.integers(-3, 4, model.n)
    other = model.transformed(np.diag(units), model.coordinates)
    assert guyan_reduction(other, keep).model.freq == pytest.approx(
        guyan_reduction(model, sorted(keep)).model.freq, rel=1e-9
    )  # condition 1e3, scaled by powers of ten that are not powers of two


def test_guyan_damping_is_the_given_ratios_or_the_models_matrix():
    model = random_model(3)[0]
    assert guyan_reduction(model, [0, 1], zeta=[0.01, 0.03]).model.zeta == pytest.approx([0.01, 0.03], rel=1e-12)
    assert guyan_reduction(model, [0, 1], zeta=0.02).model.zeta == pytest.approx([0.02, 0.02], rel=1e-12)
    reduction = guyan_reduction(model, [0, 1])
    assert pytest.approx(reduction.T.T @ model.C @ reduction.T, rel=1e-14) == reduction.model.C


def test_all_coordinates_leave_the_model_as_it_is():
    model = random_model(5)[0]
    assert guyan_reduction(model, model.coordinates).model.K.tobytes() == model.K.tobytes()
    # all modes in all coordinates: Phi^-T Phi^-1 = M, for a condition below 1e3
    exact = exact_reduction(model, model.coordinates).model
    for name in ("M", "K"):
        assert getattr(exact, name) == pytest.approx(
            getattr(model, name), abs=1e-11 * np.abs(getattr(model, name)).max()
        )


# exact reduction


def test_two_modes_of_a_chain_of_four_are_its_closed_form():
    # omega_r = 2 sin(r pi / 10), shapes sin(i r pi / 5)
    reduction = exact_reduction(chain(4), ["v3", "v1"], modes=[2, 0], zeta=0.01)
    omega = 2 * np.sin(np.array([3, 1]) * np.pi / 10)
    shapes = np.sin(np.outer([3, 1], [3, 1]) * np.pi / 5)
    assert reduction.omega == pytest.approx(omega, rel=1e-13)  # eigenvalues of a matrix of condition 10
    assert reduction.Minv_K == pytest.approx(shapes @ np.diag(omega**2) @ np.linalg.inv(shapes), rel=1e-12)  # (3.7)
    assert reduction.Minv_C == pytest.approx(shapes @ np.diag(0.02 * omega) @ np.linalg.inv(shapes), rel=1e-12)  # (3.6)
    assert reduction.model.coordinates == ("v3", "v1")
    assert reduction.modes == (2, 0)


@law
@given(seeds)
def test_exact_reduction_keeps_frequencies_ratios_and_shapes(seed):
    model, keep, reduction, _ = exactly_reducible(seed)
    reduced, count = reduction.model, len(keep)
    # condition of the shapes below 100, of the mass below 1e4, on eigenvalues that span 3e4
    assert reduced.freq == pytest.approx(model.freq[:count], rel=1e-8)
    assert reduced.zeta == pytest.approx(model.zeta[:count], rel=1e-7)
    shapes = model.eigen[1][keep, :count]
    assert reduced.M @ shapes @ shapes.T == pytest.approx(np.eye(count), abs=1e-10)
    assert reduced.K @ shapes == pytest.approx(
        reduced.M @ shapes * reduction.omega**2, abs=1e-9 * np.abs(reduced.K @ shapes).max()
    )


@law
@given(seeds)
def test_the_symmetric_form_and_the_state_space_are_one_model(seed):
    model, _, reduction, rng = exactly_reducible(seed)
    reduced, U = reduction.model, rng.normal(size=(model.n, 2))
    A, B, _, _ = reduced.state_matrices(reduction.reduce_loads(U), np.eye(reduced.n))
    assert pytest.approx(A, abs=1e-9 * np.abs(A).max()) == reduction.A  # condition of M_R below 1e4
    assert reduction.B(U) == pytest.approx(B, abs=1e-9 * np.abs(B).max())


@law
@given(seeds)
def test_response_is_exact_when_only_retained_modes_move(seed):
    model, keep, reduction, rng = exactly_reducible(seed)
    model = model.with_modal_damping(rng.uniform(0.01, 0.1, model.n))  # else C carries energy into the other modes
    reduction = exact_reduction(model, keep)
    U = model.M @ model.eigen[1][:, : len(keep)] @ rng.normal(size=(len(keep), 2))
    freq, outputs = np.geomspace(0.5, 1.5, 9) * model.freq[0], np.eye(model.n)[keep]
    full = model.frequency_response(freq, U, outputs).H
    reduced = reduction.model.frequency_response(freq, reduction.reduce_loads(U), np.eye(len(keep))).H
    # dynamic stiffness of condition up to 3e4 / 0.02 at resonance
    assert reduced == pytest.approx(full, abs=1e-8 * np.abs(full).max())
    everywhere = reduction.reduce_outputs(np.eye(model.n))  # other coordinates follow through the shapes
    full = model.frequency_response(freq, U, np.eye(model.n)).H
    reduced = reduction.model.frequency_response(freq, reduction.reduce_loads(U), everywhere).H
    assert reduced == pytest.approx(full, abs=1e-8 * np.abs(full).max())


@law
@given(seeds)
def test_a_load_on_a_retained_coordinate_stays_the_load(seed):
    model, keep, reduction, _ = exactly_reducible(seed)
    U = np.eye(model.n)[:, keep]
    assert reduction.reduce_loads(U) == pytest.approx(np.eye(len(keep)), abs=1e-11)  # Phi_R^-T Phi_R^T, condition 100
    shapes = model.eigen[1][keep, : len(keep)]
    assert reduction.Minv_U(U) == pytest.approx(shapes @ shapes.T, rel=1e-9, abs=1e-12)  # (3.8) with modal masses 1


# search


def test_elimination_of_a_held_chain_by_hand():
    # K_ii/M_ii = 2 for all four: the last goes; then v3 has 1.5/1.25 = 1.2 against 2, 2: v2 goes; both remaining: 1, 3
    search = search_retained(chain(4), ["v4", "v3", "v2", "v1"], 2, modes=1, method="elimination")
    assert search.eliminated == ("v4", "v2")
    assert search.retained == ("v1", "v3")
    assert search.exchanges == ()


@law
@given(seeds)
def test_exchange_never_harms_and_never_beats_trying_all(seed):
    model, _, rng = random_model(seed)
    model = guyan_reduction(model, range(min(model.n, 7))).model  # few enough to try all
    count = int(rng.integers(1, model.n))
    modes = int(rng.integers(1, count + 1))
    plain = search_retained(model, range(model.n), count, modes=modes, method="elimination")
    best = search_retained(model, range(model.n), count, modes=modes)
    errors = {
        names: np.abs(guyan_reduction(model, names).model.freq[:modes] / model.freq[:modes] - 1).max()
        for names in itertools.combinations(model.coordinates, count)
    }
    # the errors that the search reports are those of the reduction, to the rounding of eigenvalues that span 3e4
    for search in (plain, best):
        assert np.abs(search.freq_error).max() == pytest.approx(errors[search.retained], rel=1e-8, abs=1e-10)
    assert (
        min(errors.values()) * (1 - 1e-8) - 1e-10
        <= errors[best.retained]
        <= errors[plain.retained] * (1 + 1e-8) + 1e-10
    )
    # no single swap improves by more than the threshold, 1e-6
    for leaving, entering in itertools.product(best.retained, set(model.coordinates) - set(best.retained)):
        names = tuple(n for n in model.coordinates if (n in best.retained and n != leaving) or n == entering)
        assert errors[names] >= errors[best.retained] * (1 - 1.1e-6) - 1e-10


def test_the_search_does_not_depend_on_the_order_of_candidates(fe):
    names = list(fe.linear.coordinates)
    one = search_retained(fe.linear, names, 5, modes=4, measure="rms")
    other = search_retained(fe.linear, names[::-1], 5, modes=4, measure="rms")
    assert one.retained == other.retained
    assert one.freq_error.tobytes() == other.freq_error.tobytes()


def test_rms_and_worst_are_each_lowered_by_its_own_search(fe):
    worst = search_retained(fe.linear, translations(fe), 6, modes=6, measure="worst").freq_error
    rms = search_retained(fe.linear, translations(fe), 6, modes=6, measure="rms").freq_error
    plain = search_retained(fe.linear, translations(fe), 6, modes=6, method="elimination").freq_error
    assert worst.max() < plain.max() / 2  # one exchange takes the error of the worst from 11 % to 2 %
    assert np.linalg.norm(rms) <= np.linalg.norm(worst) * (1 + 1e-6)  # trying all 210 sets finds no better ones


def test_a_free_chain_keeps_its_rigid_motion():
    search = search_retained(chain(6, is_free=True), range(6), 3, modes=2)
    # a rigid motion is static: no error but rounding, the root of 1e-16 over a frequency of one
    assert abs(search.freq_error[0]) < 1e-6
    assert search.freq_error[1] < 0.1  # three of six masses carry the first elastic mode


# the beam


def test_the_search_finds_the_coordinates_of_the_beams_published_reduction(fe):
    # chapter 6 retains the nine translations and the tip; the rotations have the larger K/M
    search = search_retained(fe.linear, fe.linear.coordinates, 10, modes=6)
    assert list(search.retained) == translations(fe)
    assert search.freq_error.max() < 0.002  # rotations condensed at 10 in of 80 in: the sixth mode loses 0.19 %


def test_the_beam_reduced_exactly(fe):
    reduction = exact_reduction(fe.linear, translations(fe))
    # condition 1.5 of the shapes; eigenvalues span 2e3
    assert reduction.condition < 2
    assert reduction.model.freq == pytest.approx(fe.linear.freq[:10], rel=1e-11)
    assert reduction.model.zeta == pytest.approx(fe.linear.zeta[:10], rel=1e-10)
    # at the first resonance the nine modes left out deflect as springs: 1 % of the response at most
    freq = fe.linear.freq[:1]
    full = fe.linear.frequency_response(freq, fe.coils, fe.coils.T).H
    loads, outputs = reduction.reduce_loads(fe.coils), reduction.reduce_outputs(fe.coils.T)
    assert (
        pytest.approx(full, abs=0.01 * np.abs(full).max()) == reduction.model.frequency_response(freq, loads, outputs).H
    )


def test_the_beam_reduced_by_guyan(fe):
    reduction = guyan_reduction(fe.linear, translations(fe))
    error = reduction.model.freq / fe.linear.freq[:10] - 1
    assert np.all(error > 0)
    assert np.all(
        error < [1e-4] * 2 + [1e-3] * 3 + [0.002, 0.01, 0.02, 0.03, 0.04]
    )  # what condensing costs, mode by mode
    static = np.linalg.solve(fe.linear.K, fe.coils)
    ours = reduction.T @ np.linalg.solve(reduction.model.K, reduction.reduce_loads(fe.coils))
    assert ours[list(reduction.retained)] == pytest.approx(
        static[list(reduction.retained)], rel=1e-10
    )  # Guyan's identity


# what is refused


@pytest.mark.parametrize("reduce", [exact_reduction, guyan_reduction])
@pytest.mark.parametrize(
    ("retained", "error", "message"),
    [
        (["v1", "v33"], UnknownName, "unknown coordinate 'v33'; did you mean 'v3'"),
        (["v1", 4], BadStructure, "there is no coordinate 4; the model has coordinates 0 to 3"),
        ([-1], BadStructure, "there is no coordinate -1"),
        ([True], BadStructure, "True is no coordinate"),
        ([1.0], BadStructure, "1.0 is no coordinate; give a whole number or a label"),
        (["v2", 1], BadStructure, "'v2' is retained 2 times"),
        ([], BadStructure, "no coordinate is retained"),
        ("v1", BadStructure, "not the one text 'v1'"),
    ],
)
def test_retained_coordinates_that_make_no_sense_are_refused(reduce, retained, error, message):
    with pytest.raises(error, match=message):
        reduce(chain(4), retained)


@pytest.mark.parametrize(
    ("retained", "modes", "message"),
    [
        (["v2"], [1], r"mode 1 \(0.225079 Hz\) does not move the retained coordinates v2"),
        (["v1", "v3"], [0, 2], r"modes 0 \(.*\), 2 \(.*\) cannot be told apart at the retained coordinates v1, v3"),
        (["v1"], [0, 1], "2 modes for 1 retained coordinates: they cannot carry more"),
        (["v1", "v2"], [0], "1 modes for 2 retained coordinates: with fewer the reduced mass is singular"),
        (["v1", "v2"], [0, 0], "mode 0 is retained 2 times"),
        (["v1", "v2"], [0, 3], "there is no mode 3"),
    ],
)
def test_modes_that_the_coordinates_cannot_carry_are_refused(retained, modes, message):
    # the middle of three masses is a node of the second mode; the outer two move alike in the first and third
    with pytest.raises(BadStructure, match=message):
        exact_reduction(chain(3), retained, modes=modes)


@pytest.mark.parametrize("zeta", [[0.1], [[0.1, 0.1]], [0.1, np.nan]])
@pytest.mark.parametrize("reduce", [exact_reduction, guyan_reduction])
def test_damping_ratios_that_do_not_fit_are_refused(reduce, zeta):
    with pytest.raises(BadStructure, match="must be 2 finite numbers"):
        reduce(chain(3), ["v1", "v2"], zeta=zeta)


def test_a_mechanism_among_the_condensed_coordinates_is_named():
    held, loose = chain(2), chain(2, is_free=True)
    zero = np.zeros((2, 2))
    model = SecondOrderModel(
        M=np.eye(4), C=np.zeros((4, 4)), K=np.block([[held.K, zero], [zero, loose.K]]), coordinates=("a", "b", "c", "d")
    )
    with pytest.raises(BadStructure, match="K22 .* is singular: c, d can move without strain"):
        guyan_reduction(model, ["a", "b"])
    assert guyan_reduction(model, ["a", "c"]).model.freq[0] == pytest.approx(0, abs=1e-8)  # root of rounding
    with pytest.raises(BadStructure, match="1 coordinates are too few"):
        search_retained(SecondOrderModel(M=np.eye(2), C=zero, K=zero, coordinates=("a", "b")), [0, 1], 1, modes=1)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"count": 4}, BadStructure, "3 candidates"),
        ({"count": 1}, BadStructure, "1 <= modes <= count"),
        ({"modes": 0}, BadStructure, "0 modes"),
        ({"method": "exchang"}, UnknownName, "did you mean 'exchange'"),
        ({"measure": "mean"}, UnknownName, "accepted: worst, rms"),
        ({"candidates": ["v1", "w2"]}, UnknownName, "did you mean 'v2'"),
    ],
)
def test_a_search_that_makes_no_sense_is_refused(change, error, message):
    asked = {"candidates": ["v1", "v2", "v3"], "count": 2, "modes": 2} | change
    with pytest.raises(error, match=message):
        search_retained(chain(4), **asked)


@pytest.mark.parametrize("U", [np.ones(4), np.ones((3, 1)), np.full((4, 1), np.nan)])
def test_loads_that_do_not_fit_the_full_model_are_refused(U):
    with pytest.raises(BadStructure, match=r"are no finite \(4, k\)"):
        guyan_reduction(chain(4), ["v1"]).reduce_loads(U)
