"""The FE code of the generator against closed forms, and against the FE code of the plants where both have converged."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from command import run
from scipy import linalg, special

from vlab.errors import BadStructure
from vlab.fe import build_fe_model
from vlab.proof.conceal import _drawn_from
from vlab.proof.generator import built_structure, laboratory
from vlab.proof.generator.beam_elements import hanging_string
from vlab.proof.generator.built_structure import ALONG, WAVES, modal_properties
from vlab.proof.generator.concealed import Wanted, conceal
from vlab.proof.generator.frame_statics import Span, hung_frame
from vlab.proof.generator.plan import plan
from vlab.proof.generator.structure_fe import Variation, assemble
from vlab.proof.suites import OWN_FE, SHARED_FE, SOURCES, drawn_suites
from vlab.structure import load_structure
from vlab.structure.discretisation import Variant
from vlab.structure.model import Bar, Coil, Damping, Mass, Point, Section, Structure, Support

NOTHING = Variation({})


def bar_structure(
    section: Section, *, length=1.0, spans=4, vertical=False, supports=(), gravity=0.0, mass=()
) -> Structure:
    """One bar through equally spaced points p0, p1, and so on, upwards or to the right."""
    at = np.linspace(0.0, length, spans + 1)
    points = [Point(name=f"p{i}", x=0.0 if vertical else s, z=s if vertical else 0.0) for i, s in enumerate(at)]
    return Structure(
        format="vlab-structure-1",
        name="bar",
        title="bar",
        exciter="coil",
        gravity=gravity,
        section={"bar": section},
        point=tuple(points),
        bar=(Bar(name="bar", section="bar", points=tuple(p.name for p in points)),),
        support=tuple(Support(name=f"{p}", at=p, holds=holds) for p, holds in supports),
        coil=(Coil(name="coil", at="p1", mass=0.0),),
        mass=mass,
        damping=Damping(ratios=(), higher=0.0),
        variant={"plain": Variant()},
    )


THIN = Section(width=0.05, thickness=1e-3, density=7800.0, bending_stiffness=0.9)


def euler(section: Section, roots: list[float], length: float = 1.0) -> np.ndarray:
    return np.array(roots) ** 2 / length**2 * np.sqrt(section.bending_stiffness / section.mass_per_length)


# ---- closed forms ---------------------------------------------------------------------------------------------------


def test_a_free_free_beam_has_the_roots_of_cosh_cos_1():
    fe = assemble(bar_structure(THIN), NOTHING)
    shift = 1.0  # makes the inverse problem definite, which resolves the lowest modes
    omega = np.sqrt(np.maximum(1.0 / linalg.eigh(fe.M, fe.K + shift * fe.M, eigvals_only=True)[::-1] - shift, 0.0))
    # The strip is a thousandth as thick as long: shear and rotary inertia take n^2 pi^2 (1/12 + 0.26) 1e-6 at most.
    assert omega[2:6] == pytest.approx(euler(THIN, [4.730041, 7.853205, 10.995608, 14.137165]), rel=1e-4)
    assert omega[:2] == pytest.approx(0.0, abs=1e-3 * omega[2])


def test_a_cantilever_has_the_roots_of_cosh_cos_minus_1():
    fe = assemble(bar_structure(THIN, spans=2, supports=[("p0", ("v", "rx", "rz"))]), NOTHING)
    omega, shapes = fe.modes(200.0)
    assert omega[:3] == pytest.approx(euler(THIN, [1.875104, 4.694091, 7.854757]), rel=1e-4)
    assert shapes.T @ fe.M @ shapes == pytest.approx(np.eye(len(omega)), abs=1e-9)


def test_a_thick_beam_on_pins_has_timoshenko_s_frequencies():
    """With k = n pi/L the sine of w and the cosine of psi solve the equations exactly, for any shear stiffness."""
    EI, GA, mu, polar, length = 3.0e4, 6.0e4, 25.0, 0.06, 1.6
    section = Section(bending_stiffness=EI, shear_stiffness=GA, mass_per_length=mu, polar_inertia_per_length=polar)
    held = [("p0", ("v",)), ("p4", ("v",))]
    omega, _ = assemble(bar_structure(section, length=length, supports=held), NOTHING).modes(1e4)
    for n in (1, 2, 3):
        k = n * np.pi / length
        K = np.array([[GA * k**2, -GA * k], [-GA * k, EI * k**2 + GA]])
        exact = np.sqrt(linalg.eigh(K, np.diag([mu, polar / 2]), eigvals_only=True)[0])
        assert np.abs(omega / exact - 1.0).min() < 1e-7


@pytest.mark.parametrize("stiff", [True, False])
def test_a_hung_bar_swings_as_a_pendulum_or_as_a_chain(stiff):
    """A rigid rod: sqrt(3 g/2 L). A chain: half the zeros of J0 times sqrt(g/L)."""
    g, length = 9.81, 2.0
    thickness, EI = (0.05, 1e6) if stiff else (1e-3, 1e-6)
    section = Section(width=0.05, thickness=thickness, density=7800.0, bending_stiffness=EI)
    made = bar_structure(section, length=length, spans=8, vertical=True, supports=[("p8", ("v",))], gravity=g)
    omega, _ = assemble(made, NOTHING).modes(5.0)
    if stiff:  # bending at 140 Hz adds its squared frequency ratio, 1e-5
        turned = length**2 / 3 + thickness**2 / 12
        assert omega[0] == pytest.approx(np.sqrt(0.5 * g * length / turned), rel=2e-5)
    else:  # the end layer of bending, sqrt(EI/T) = 3e-4 of the length, stays below the tolerance
        assert omega[:4] == pytest.approx(special.jn_zeros(0, 4) / 2 * np.sqrt(g / length), rel=2e-3)


def test_a_weight_below_a_light_bar_is_a_simple_pendulum():
    g, length = 9.81, 2.0
    section = Section(width=0.01, thickness=1e-3, density=1.0, bending_stiffness=1e-4)
    bob = (Mass(name="bob", at="p0", mass=3.0),)
    made = bar_structure(section, length=length, vertical=True, supports=[("p4", ("v",))], gravity=g, mass=bob)
    assert assemble(made, NOTHING).modes(1.0)[0][0] == pytest.approx(np.sqrt(g / length), rel=1e-4)


def test_a_string_is_its_tension_over_its_length_with_a_third_of_its_mass():
    stiffness, mass = hanging_string(lambda s: 300.0 + 0.0 * s, 1.1, 0.06)
    assert (stiffness, mass) == pytest.approx((300.0 / 1.1, 0.06 * 1.1 / 3), rel=1e-12)
    heavy, _ = hanging_string(lambda s: 2.0 + 5.0 * s, 1.1, 0.5)
    assert heavy == pytest.approx(5.0 / np.log1p(5.0 * 1.1 / 2.0), rel=1e-12)


def test_a_bar_between_pins_bends_as_a_simple_beam_and_carries_its_weight():
    weight, length = 7.0, 1.4
    points = {"a": (0.0, 0.0), "m": (0.5, 0.0), "b": (length, 0.0)}
    spans = [Span(start=p, end=q, axial=1e7, bending=40.0, weight=weight) for p, q in pairwise(points)]
    left, right = hung_frame(tuple(spans), points.__getitem__, {}, {"a", "b"})
    x = np.linspace(0.0, 0.5, 5)
    # n points down: what sags pulls its fibres.
    assert left.moment(x) == pytest.approx(weight * x * (length - x) / 2, abs=1e-9)
    assert right.moment(x) == pytest.approx(weight * (0.5 + x) * (length - 0.5 - x) / 2, abs=1e-9)
    assert left.axial(x) == pytest.approx(0.0, abs=1e-9)


def test_two_bars_hold_a_weight_by_their_axial_forces():
    """Thin bars at 45 degrees: each carries W/sqrt(2)."""
    points = {"a": (-1.0, 0.0), "w": (0.0, -1.0), "b": (1.0, 0.0)}
    spans = [Span(start=p, end=q, axial=1e8, bending=1e-3, weight=0.0) for p, q in pairwise(points)]
    found = hung_frame(tuple(spans), points.__getitem__, {"w": 30.0}, {"a", "b"})
    assert [float(r.axial(np.array(0.3))) for r in found] == pytest.approx([30.0 / np.sqrt(2)] * 2, rel=1e-6)
    with pytest.raises(BadStructure, match="mechanism"):
        hung_frame(tuple(spans), points.__getitem__, {"w": 30.0}, set())


def test_a_structure_that_its_weight_topples_is_refused():
    fe = assemble(bar_structure(THIN, supports=[("p0", ("v", "rx", "rz"))]), NOTHING)
    with pytest.raises(BadStructure, match="not stable"):
        replace(fe, K=fe.K - 2.0 * fe.modes(10.0)[0][0] ** 2 * fe.M).modes(5.0)


# ---- against the FE code of the plants ------------------------------------------------------------------------------

REFINE = {"beam": 3, "grid": 2}
SHEAR_SOFT = {f"bar:{n}-{n + 1}" for n in range(13, 17)}
"""Spans of the sandwich beam, whose bending the other source takes from chord and end slopes as if no shear were in them."""


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_both_fe_codes_agree_where_both_have_converged(name):
    """Nothing is shared: the other elements, strings with weight and rotary inertia change less than 0.03 %."""
    structure = load_structure(name)
    own, other = assemble(structure, NOTHING), build_fe_model(structure, "physical", refine=REFINE[name])
    omega, _ = own.modes(60.0)
    # 0.013 % at most in the beam, 0.03 % in the grid, whose shear-soft beam of 12 m^-1 converges slowest.
    assert omega[:9] / (2 * np.pi) == pytest.approx(other.linear.freq[:9], rel=5e-4)
    used = [p for p in own.rows if np.any(own.rows[p][0])]
    rows = np.array([own.rows[p][0] for p in used])
    soft = np.einsum("ij,ji->i", rows, np.linalg.solve(own.K, rows.T))
    other_rows = other.deflections(used)
    assert soft == pytest.approx(
        np.einsum("ij,ji->i", other_rows, np.linalg.solve(other.linear.K, other_rows.T)), rel=1e-3
    )


def test_the_shapes_of_the_beam_agree_too():
    structure = load_structure("beam")
    own, other = assemble(structure, NOTHING), build_fe_model(structure, "physical", refine=3)
    a = np.array([rows[0] for rows in own.rows.values()]) @ own.modes(60.0)[1][:, :8]
    b = other.deflections(list(own.rows)) @ other.linear.eigen[1][:, :8]
    mac = np.einsum("ij,ij->j", a, b) ** 2 / np.einsum("ij,ij->j", a, a) / np.einsum("ij,ij->j", b, b)
    assert mac.min() > 1 - 1e-6
    # Modal masses: unit modal mass makes the shapes equal in size, not only in form.
    assert np.abs(a) == pytest.approx(np.abs(b), abs=2e-3 * np.abs(b).max())


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_benches_of_both_sources_have_the_same_places_and_transducers(name):
    own, other = SOURCES[OWN_FE][name]().build({}, {}), SOURCES[SHARED_FE][name]().build({}, {})
    # The other source also hides at a held point, and at spans of the top beam that the plants do not have.
    bare = {"point22"} | {f"bar:{n}-{n + 1}" for n in range(17, 22)} if name == "grid" else set()
    assert set(own.places) == set(other.places) - bare
    assert list(own.actuators) == list(other.actuators)
    assert [(k, s.kind, s.order) for k, s in own.sensors.items()] == [
        (k, s.kind, s.order) for k, s in other.sensors.items()
    ]
    for place, p in own.places.items():
        q = other.places[place]
        assert (p.angular, p.alike, p.actuator) == (q.angular, q.alike, q.actuator), place
        assert set(p.near) == set(q.near) & set(own.places), place
        assert p.stiffness == pytest.approx(q.stiffness, rel=2e-3)
        if p.K is not None and place not in SHEAR_SOFT:  # a softer span takes the same share of every mode's stiffness
            lost = [np.diag(x.K)[:6] / np.diag(bench.K)[:6] for x, bench in ((p, own), (q, other))]
            assert lost[0] == pytest.approx(lost[1], rel=0.03, abs=1e-4)
    damped = [np.diag(b.C)[:6] / np.sqrt(np.diag(b.K)[:6]) for b in (own, other)]
    assert damped[0] == pytest.approx(damped[1], rel=1e-6)


# ---- deviations -----------------------------------------------------------------------------------------------------


def drawn(blueprint, seed):
    rng = np.random.default_rng(seed)
    return {b.name: b.sd * rng.standard_normal() for b in blueprint.benign if b.sd}


def test_local_deviations_have_the_stated_size_and_no_mean():
    rng, share = np.random.default_rng(1), np.linspace(0.0, 1.0, 401)
    sd = ALONG["stiffness"] * np.sqrt(2.0 / WAVES)
    logs = []
    for _ in range(200):
        values = {f"along:stiffness:bar:{j + 1}": sd * rng.standard_normal() for j in range(WAVES)}
        logs.append(np.log(Variation(values).along("stiffness", "bar", share)))
    assert np.std(logs) == pytest.approx(ALONG["stiffness"], rel=0.1)
    assert np.abs(np.mean(logs, axis=1)).max() < 2e-4


@pytest.mark.parametrize("name", ["beam", "grid"])
def test_deviations_move_modes_that_sections_cannot_follow(name):
    """A common factor of stiffness moves all bending modes alike; deviations along the bars do not."""
    blueprint = SOURCES[OWN_FE][name]()
    local = {k: v for k, v in drawn(blueprint, 3).items() if k.startswith(("along", "lump"))}
    before, after = (blueprint.build(f, {}).frequencies() for f in ({}, local))
    shift = (after / before - 1.0)[: 6 if name == "beam" else 10]
    assert 2e-4 < np.ptp(shift) < 0.03


def test_matrices_give_the_frequencies_and_dampings_of_the_bench():
    blueprint = built_structure.beam()
    factors = {**drawn(blueprint, 5), "frequency:2": 0.004}
    bench, (M, C, K) = blueprint.build(factors, {}), blueprint.matrices(factors)
    n = 6
    omega = linalg.eigh(M, K, eigvals_only=True)[::-1][:n] ** -0.5
    assert omega / (2 * np.pi) == pytest.approx(bench.frequencies()[:n], rel=1e-6)
    for own, full in ((bench.M, M), (bench.C, C), (bench.K, K)):
        assert bench.basis is not None
        assert (bench.basis.T @ full @ bench.basis)[:n, :n] == pytest.approx(own[:n, :n], abs=1e-6 * np.abs(own).max())
    del factors["frequency:2"]
    moved = bench.frequencies() / blueprint.build(factors, {}).frequencies() - 1.0
    assert np.count_nonzero(np.abs(moved) > 1e-9) == 1
    assert moved.max() == pytest.approx(np.expm1(0.004), rel=1e-6)


def test_every_measured_ratio_is_of_one_mode():
    structure = load_structure("beam")
    for factors in ({}, drawn(built_structure.beam(), 7)):
        plain = {k: v for k, v in factors.items() if not k.startswith("damping")}
        zeta = modal_properties("beam", plain)[3]
        assert sorted(zeta)[-6:] == pytest.approx(sorted(structure.damping.ratios))


def test_a_sensor_beside_its_point_adds_the_slope():
    blueprint = built_structure.beam()
    here, there = (blueprint.build(f, {}) for f in ({}, {"place:sensor:40in": 2e-3}))
    by_shift = blueprint.build({}, {"40in": 2e-3})
    moved = there.sensors["sensor:40in"].row - here.sensors["sensor:40in"].row
    step = here.places["beam:30in-40in"].row  # slopes differ by a span's bending: the same order as the slope
    assert 0 < np.abs(moved).max() < 2e-3 * 20 * np.abs(step).max()
    assert by_shift.sensors["sensor:40in"].row == pytest.approx(there.sensors["sensor:40in"].row)
    assert there.sensors["probe:30in"].row == pytest.approx(here.sensors["probe:30in"].row)


# ---- cases ----------------------------------------------------------------------------------------------------------


def test_plans_have_four_fit_recordings_and_hold_outs():
    roles = [r.role for r in plan(built_structure.beam(), np.random.default_rng(2)).recordings]
    assert roles.count("fit") == 4
    assert roles.count("holdout") >= 2


def test_commands_stay_in_the_range_of_the_converter():
    """16 bits over four times the rms of the loudest command; peaks of a multisine reach about three times it."""
    blueprint = built_structure.beam()
    commands = plan(blueprint, np.random.default_rng(3)).commands
    assert np.abs(commands).max() < 2**15 * blueprint.command_step


def test_a_case_states_round_values_that_are_at_least_those_drawn():
    for blueprint in (built_structure.beam(), built_structure.grid()):
        for b in blueprint.benign:
            if b.kind == "local":
                assert b.prior == 0.0
            elif b.kind != "frequency":
                assert b.sd < b.prior == blueprint.uncertain[b.kind]


def test_plans_sealed_without_a_source_keep_the_fe_code_of_the_plants():
    old = {"benches": ["beam"], "seed": 3}
    assert _drawn_from(old)["structures"] == SHARED_FE
    assert _drawn_from({**old, "structures": OWN_FE})["structures"] == OWN_FE
    assert SOURCES[SHARED_FE]["beam"] is laboratory.beam


def test_an_unknown_source_is_refused_with_the_known_ones(capsys, tmp_path):
    status, out, err = run(capsys, "conceal", "--structures", "own", "--out", str(tmp_path / "cases"))
    assert (status, out) == (2, "")
    assert OWN_FE in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_third_of_the_structures_hides_nothing():
    order = drawn_suites(["structures"], 36, 1)
    assert order.count("null") == 12
    assert order.count("out-of-library") == 3


@pytest.mark.slow
def test_a_beam_with_nothing_hidden_has_an_error_that_calibration_leaves(tmp_path):
    case = conceal(built_structure.beam(), Wanted(suite="null"), np.random.default_rng(2))
    error = case.truth["model_error"]
    # A calibrated model of a laboratory structure is wrong by a per cent or a few.
    assert 2e-3 < error["over_signal"] < 0.2
    assert error["over_noise"] < error["uncalibrated"]
    assert case.truth["noise"] in {f"{n} to {n + 10} dB" for n in range(20, 60, 10)}
    assert case.law is None
    assert {"along:stiffness:beam:1", "lump:coil:base", "gain:base", "tension:all"} <= set(case.truth["benign"])
