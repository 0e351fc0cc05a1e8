"""The linear twin against MuJoCo's own runs and steps, and its derivatives against rebuilt models."""

import mujoco
import numpy as np
import pytest
import rig_oscillator
from rigs import oscillator_case
from scipy import linalg

from vlab.cases import load_case, simulate
from vlab.diagnose.parameters.discrete import discretise
from vlab.diagnose.parameters.mjcf import adjusted
from vlab.diagnose.parameters.mode_selection import as_stepped
from vlab.diagnose.parameters.observation import channel_rows
from vlab.diagnose.parameters.recorded_runs import read_runs
from vlab.diagnose.parameters.structure import adjusted_structure
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.problem import model_kind_of
from vlab.diagnose.settings import STRUCTURE_PRIORS
from vlab.errors import BadCase
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.fe.second_order import SecondOrderModel
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.plants import build_plant
from vlab.plants.mjcf import build_mjcf
from vlab.recordings import write_recording

BEAM_CASE = """[model]
structure = "beam"
plant = "{plant}"
[[recording]]
file = "run.parquet"
role = "fit"
time = "time"
initial = "rest"
[[recording.channel]]
column = "excitation:base"
at = "base"
kind = "{kind}"
unit = "N"
input = true
[[recording.channel]]
column = "sensor:20in"
at = "20in"
kind = "velocity"
unit = "m/s"
"""

NESTED = """<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/><worldbody>
<body name="a"><joint name="a" type="slide" axis="1 0 0" stiffness="900" damping="3"/><geom size="0.1" mass="1"/>
<body name="b"><joint name="b" type="slide" axis="1 0 0" stiffness="600" damping="2"/><geom size="0.1" mass="0.5"/></body>
</body></worldbody></mujoco>"""


def corrected(case):
    """Return a case with the modes of the FE model, if it has a coarse mesh."""
    return model_kind_of(case).with_corrected_mesh(case)


def integrated(problem, signals):
    """March the twin from rest by its sampled matrices alone, its uncertain parameters at zero; (n, n_channels)."""
    reduced_model = problem.reduced_model
    M, C, K, gain, sensor = (part[0] for part in reduced_model.matrices(np.zeros((1, len(reduced_model.changes)))))
    inputs = np.hstack([reduced_model.forces * gain, reduced_model.loads])
    system = discretise(M[None], C[None], K[None], inputs, reduced_model.rows, signals.h)
    f = np.hstack([signals.u, signals.load])
    x, out = np.zeros(2 * reduced_model.m), []
    for row in f:
        out.append(sensor * (system.C[0] @ x + system.D[0] @ row))
        x = system.A[0] @ x + system.B[0] @ row
    return np.array(out)


def reduced_model_and_mujoco(problem):
    """Return the largest error of the twin over channels and runs, relative to what MuJoCo's run has as rms."""
    errors = []
    for run, signals in zip(problem.runs, problem.signals, strict=True):
        exact = simulate(problem.plant, run).recording
        ours = integrated(problem, signals)
        assert len(ours) == len(exact)  # not thinned
        theirs = np.column_stack([exact[name] for name in problem.names])
        errors.append(np.sqrt(np.mean((ours - theirs) ** 2, axis=0)) / theirs.std(axis=0))
    return float(np.max(errors))


@pytest.fixture
def short(tmp_path, monkeypatch):
    """Build a chain of three masses without hidden physics; 4 s, so that no sample is left out."""
    monkeypatch.setattr(rig_oscillator, "SECONDS", 4.0)

    def build(integrator="RK4", joint_damping=0.0, **given):
        oscillator_case(tmp_path, benign=0.0, **given)
        file = tmp_path / "rig.xml"
        text = file.read_text().replace('integrator="RK4"', f'integrator="{integrator}"')
        file.write_text(text.replace('axis="1 0 0"/>', f'axis="1 0 0" damping="{joint_damping}"/>'))
        return load_case(tmp_path)

    return build


# RK4 is all but exact: (81 rad/s x 1 ms)^5/120 a step. The eigenvalues of a semi-implicit step are the twin's, too; its
# response to a force that changes every other step is off by (20 rad/s x 2 ms)^2 in the mode that moves most.
@pytest.mark.slow
@pytest.mark.parametrize(("integrator", "tolerance"), [("RK4", 1e-5), ("Euler", 4e-3)])
@pytest.mark.parametrize("sensors", ["displacement", "velocity"])
def test_the_twin_of_a_chain_moves_as_in_mujoco(short, integrator, tolerance, sensors):
    problem = prepare(short(integrator, sensors=sensors))
    assert problem.reduced_model.m == 3
    assert reduced_model_and_mujoco(problem) < tolerance


@pytest.mark.parametrize(
    ("plant", "kind"), [("fe", "excitation"), ("composite", "excitation"), ("composite", "command")]
)
def test_the_twin_of_the_beam_moves_as_in_mujoco(beam, tmp_path, plant, kind):
    """A command passes the laboratory's delay, hold and filter; an excitation is a force already."""
    experiment = Experiment(
        plant=build_plant(beam, plant), seconds=1.0, excitation=Multisine(level=0.05), excite="base"
    )
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    (tmp_path / "case.toml").write_text(BEAM_CASE.format(plant=plant, kind=kind))
    problem = prepare(load_case(tmp_path))
    # The ten modes below twice the fastest motion are kept; what is left is the motion of those above (0.3 % measured on
    # the FE plant) and the semi-implicit step.
    assert reduced_model_and_mujoco(problem) < 5e-3


def stepped_eigenvalues(plant):
    """Return the continuous eigenvalues of MuJoCo's own one-step map, by its finite differences."""
    model, data = plant.model, plant.new_data()
    size = 2 * model.nv
    A = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, A, None, None, None)
    return np.log(np.linalg.eigvals(A).astype(complex)) / plant.timestep


def eigenvalues(M, C, K):
    """Return the eigenvalues of a second-order system above the real axis."""
    m = len(M)
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    s = np.linalg.eigvals(A)
    return s[s.imag > 0]


@pytest.mark.parametrize(
    ("integrator", "joint_damping"), [("Euler", 0.0), ("Euler", 3.0), ("implicit", 0.0), ("implicitfast", 3.0)]
)
def test_the_twin_has_the_eigenvalues_of_mujocos_step(short, integrator, joint_damping):
    case = short(integrator, joint_damping)
    reduced_model = prepare(case).reduced_model
    exact, ours = stepped_eigenvalues(case.plant), eigenvalues(reduced_model.M, reduced_model.C, reduced_model.K)
    nearest = [exact[np.argmin(np.abs(exact - s))] for s in ours]
    # what is left is the finite differences' rounding, 1e-16/1e-6 beside omega h of 0.02
    np.testing.assert_allclose(ours, nearest, rtol=1e-6)
    plain = np.sqrt(np.abs(reduced_model.omega) ** 2)
    assert np.abs(np.abs(ours) - plain).max() > 1e-5 * plain.max()  # the step does change something


def test_the_twin_has_the_eigenvalues_of_an_implicit_step_within_a_tree(tmp_path):
    (tmp_path / "rig.xml").write_text(NESTED)
    plant = build_mjcf("rig.xml", folder=tmp_path)
    linear = plant.linearise()
    basis = linear.eigen[1]
    added = as_stepped(plant, linear, basis, plant.timestep)
    ours = eigenvalues(
        *(basis.T @ part @ basis + more for part, more in zip((linear.M, linear.C, linear.K), added, strict=True))
    )
    exact = stepped_eigenvalues(plant)
    nearest = [exact[np.argmin(np.abs(exact - s))] for s in ours]
    np.testing.assert_allclose(ours, nearest, rtol=1e-6)


def reduced_model_differences(reduced_model, theta, step=1e-5):
    """Return the derivatives of M, C and K by every uncertain parameter by central differences, lists of each."""
    sets = np.concatenate([theta + step * np.eye(len(theta)), theta - step * np.eye(len(theta))])
    n = len(theta)
    return [(part[:n] - part[n:]) / (2 * step) for part in reduced_model.matrices(sets)[:3]]


@pytest.mark.parametrize("of_fe", [False, True])
def test_the_uncertainty_of_a_structure_is_what_a_rebuilt_plant_has(beam, tmp_path, of_fe):
    experiment = Experiment(plant=build_plant(beam), seconds=1.0, excitation=Multisine(level=0.05), excite="base")
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    (tmp_path / "case.toml").write_text(BEAM_CASE.format(plant="composite", kind="excitation"))
    case = load_case(tmp_path)
    problem = prepare(corrected(case) if of_fe else case)
    reduced_model = problem.reduced_model
    theta = 0.5 * reduced_model.prior * np.resize([1.0, -1.0, 1.0, 1.0, -1.0], len(reduced_model.prior))
    theta[[c.actuator is not None or c.sensor is not None for c in reduced_model.changes]] = 0.0
    stepped = as_stepped(problem.plant, problem.plant.linearise(), reduced_model.shapes, problem.plant.timestep)
    row = problem.plant.port_rows(["20in"])
    for set_of, tolerance in ((theta, 5e-4), (0 * theta, 1e-9)):
        structure, variant = problem.case.structure, problem.case.table.model.variant
        linear = adjusted_structure(structure, problem.plant, variant, problem.parameters, set_of).linearise()
        M, C, K = (part[0] for part in reduced_model.matrices(set_of[None])[:3])
        M, C, K = (part - more for part, more in zip((M, C, K), stepped, strict=True))
        ours = SecondOrderModel(M=M, C=C, K=K, coordinates=("",) * reduced_model.m)
        seen = np.abs(row @ linear.eigen[1])[0] > 1e-3
        # first order in what moves the frequencies by up to 1.5 %: its square and the mesh's own derivative are left
        np.testing.assert_allclose(ours.eigen[0][:6], linear.eigen[0][seen][:6], rtol=tolerance)
        # a close pair turns by ten times what its frequencies are off, and its ratios with it
        np.testing.assert_allclose(ours.zeta[:6], linear.zeta[seen][:6], rtol=20 * tolerance)


def test_what_is_fitted_on_the_twin_has_its_frequencies_in_the_rebuilt_plant(beam, tmp_path):
    experiment = Experiment(plant=build_plant(beam), seconds=1.0, excitation=Multisine(level=0.05), excite="base")
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    (tmp_path / "case.toml").write_text(BEAM_CASE.format(plant="composite", kind="excitation"))
    problem = prepare(corrected(load_case(tmp_path)))
    reduced_model, step = problem.reduced_model, problem.plant.timestep
    theta = reduced_model.prior * np.resize([1.0, -1.0, 1.0, 1.0, -1.0], len(reduced_model.prior))
    M, _, K = (part[0] for part in reduced_model.matrices(theta[None])[:3])
    wanted = np.sqrt(linalg.eigh(K, M, eigvals_only=True))
    off = []
    for set_of in (theta, problem.for_plant(theta)):
        plant = adjusted_structure(problem.case.structure, problem.plant, "published", problem.parameters, set_of)
        linear = plant.linearise()
        shapes = linear.eigen[1]
        mass, _, stiffness = (np.diag(added) for added in as_stepped(plant, linear, shapes, step))
        shown = np.sqrt((linear.eigen[0] ** 2 + stiffness) / (1.0 + mass))
        off.append([np.abs(shown / w - 1.0).min() for w in wanted[:6]])
    assert max(off[0]) > 1e-5  # two close modes turn, and the twin's coordinates stay
    assert max(off[1]) < 1e-7
    same = problem.adjusted(theta).linearise()
    np.testing.assert_allclose(same.eigen[0], linear.eigen[0], rtol=1e-9)


def test_coils_and_sensors_beside_their_points_push_and_read_what_a_rebuilt_plant_reads(beam, tmp_path):
    experiment = Experiment(plant=build_plant(beam), seconds=1.0, excitation=Multisine(level=0.05), excite="base")
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    (tmp_path / "case.toml").write_text(BEAM_CASE.format(plant="composite", kind="excitation"))
    problem = prepare(corrected(load_case(tmp_path)))
    reduced_model, theta = problem.reduced_model, np.zeros(len(problem.parameters))
    places = [i for i, p in enumerate(problem.parameters) if p.kind == "place"]
    assert len(places) == len(reduced_model.shifts) + len(reduced_model.coil_shifts)
    assert len(reduced_model.shifts) == len(reduced_model.coil_shifts) == 1
    theta[places] = 1e-3 * np.resize([1.0, -2.0], len(places))
    rebuilt = problem.adjusted(theta)
    moved = channel_rows(rebuilt, problem.channels).onto(reduced_model.shapes)
    ours, before = reduced_model.rows_at(theta), reduced_model.rows
    for part in ("at_q", "at_v"):
        change = getattr(moved, part) - getattr(before, part)
        in_band = (
            np.abs(reduced_model.omega) < 2 * np.pi * problem.highest_hz
        )  # the FE model's modes, and the mesh's own above
        np.testing.assert_allclose(
            (getattr(ours, part) - getattr(before, part))[:, in_band],
            change[:, in_band],
            atol=1e-3 * max(np.abs(change).max(), 1e-12),  # their shapes are carried over at the points
        )
    assert np.abs(moved.at_v - before.at_v).max() > 1e-3 * np.abs(before.at_v).max()
    coil = reduced_model.coil_shifts[0].actuator
    change = ((rebuilt.actuator_forces() - problem.plant.actuator_forces()).T @ reduced_model.shapes)[coil]
    ours = (reduced_model.forces_at(theta[None])[0] - reduced_model.forces)[:, coil]
    np.testing.assert_allclose(ours[in_band], change[in_band], atol=1e-3 * np.abs(change).max())
    assert np.abs(change).max() > 1e-3 * np.abs(reduced_model.forces).max()


def test_only_a_coarse_mesh_gets_the_modes_of_the_fe_model(beam, tmp_path, short):
    experiment = Experiment(plant=build_plant(beam), seconds=1.0, excitation=Multisine(level=0.05), excite="base")
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    for plant in ("composite", "modal"):
        (tmp_path / "case.toml").write_text(BEAM_CASE.format(plant=plant, kind="excitation"))
        case = load_case(tmp_path)
        meshed = corrected(case)
        assert (meshed is case) == (plant == "modal")
        if plant == "composite":
            top = 2 * read_runs(case, ("fit",)).highest_hz
            fe = build_fe_model(beam)
            freq = fe.linear.freq[driven_modes(fe.coils.T @ fe.linear.eigen[1])]
            assert meshed.structure.tuning.of_fe == np.sum(freq <= top) > 3
            own = {p.name: p.sd for p in prepare(meshed).parameters if p.kind == "frequency"}
            assert len(own) == np.sum(freq <= 0.55 * top)  # 1.1 times the highest frequency recorded
            assert set(own.values()) == {STRUCTURE_PRIORS.of_fe_sd}
            assert corrected(meshed) is meshed
    rig = short()
    assert corrected(rig) is rig


@pytest.mark.slow
def test_mode_by_mode_uncertainty_is_what_a_rebuilt_model_has(short):
    case = short()
    problem = prepare(case)
    reduced_model, basis = problem.reduced_model, problem.reduced_model.shapes
    rng = np.random.default_rng(0)
    theta = 0.1 * rng.standard_normal(len(reduced_model.changes))
    linear = adjusted(case.plant, problem.parameters, theta).linearise()
    M, C, K, gain, _ = (part[0] for part in reduced_model.matrices(theta[None]))
    together = [basis.T @ part @ basis for part in (linear.M, linear.C, linear.K)]
    for ours, rebuilt in zip((M, C, K), together, strict=True):
        # an element under two factors has their product; central differences as below
        np.testing.assert_allclose(ours, rebuilt, atol=1e-6 * np.abs(rebuilt).max())
    for part, after in zip(
        zip(*reduced_model.slopes(theta), strict=True), reduced_model_differences(reduced_model, theta), strict=True
    ):
        for slope, difference in zip(part, after, strict=True):
            np.testing.assert_allclose(
                0.0 if slope is None else slope, difference, atol=1e-5 * np.abs(together[2]).max()
            )
    names = [c.name for c in reduced_model.changes]
    alone = np.zeros(len(theta))
    alone[names.index("tendon:spring2:stiffness")] = 0.3
    K = reduced_model.matrices(alone[None])[2][0]
    # independent of all of the project's editing: another stiffness in the file
    text = (case.folder / "rig.xml").read_text()
    text = text.replace('<fixed name="spring2">', f'<fixed name="spring2" stiffness="{2000 * np.exp(0.3):.12g}">')
    (case.folder / "other.xml").write_text(text)
    rebuilt = build_mjcf("other.xml", folder=case.folder).linearise()
    # central differences of exp(theta) with a step of 1e-3: 1e-6/6
    np.testing.assert_allclose(K, basis.T @ rebuilt.K @ basis, atol=1e-6 * np.abs(K).max())
    assert gain.shape == (1,)


@pytest.mark.slow
def test_every_single_parameter_changes_the_twin_as_it_changes_the_model(short):
    case = short(joint_damping=1.0)
    problem = prepare(case)
    reduced_model, basis = problem.reduced_model, problem.reduced_model.shapes
    seen = set()
    for i, parameter in enumerate(problem.parameters):
        if parameter.actuator is not None or parameter.sensor is not None:
            continue
        theta = np.zeros(len(reduced_model.changes))
        theta[i] = 0.2
        linear = adjusted(case.plant, [parameter], np.array([0.2])).linearise()
        parts = reduced_model.matrices(theta[None])[:3]
        for ours, rebuilt in zip(parts, (linear.M, linear.C, linear.K), strict=True):
            rebuilt = basis.T @ rebuilt @ basis
            np.testing.assert_allclose(ours[0], rebuilt, atol=1e-5 * np.abs(rebuilt).max(), err_msg=parameter.name)
        seen.add(parameter.kind)
    assert seen == {"stiffness", "damping", "mass"}


@pytest.mark.slow
def test_a_gain_multiplies_force_or_reading(short):
    problem = prepare(short())
    theta = np.zeros(len(problem.reduced_model.changes))
    names = [c.name for c in problem.reduced_model.changes]
    theta[names.index("gain:motor")], theta[names.index(f"sensor:{problem.names[1]}")] = 0.1, -0.2
    *_, gain, sensor = problem.reduced_model.matrices(theta[None])
    np.testing.assert_allclose(gain[0], [np.exp(0.1)])
    np.testing.assert_allclose(sensor[0], [1.0, np.exp(-0.2), 1.0])


def test_the_beams_uncertain_parameters_shift_its_modes_as_a_rebuilt_beam_has_them(beam, tmp_path):
    experiment = Experiment(plant=build_plant(beam, "fe"), seconds=0.5, excitation=Multisine(level=0.05), excite="base")
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    (tmp_path / "case.toml").write_text(BEAM_CASE.format(plant="fe", kind="excitation"))
    problem = prepare(load_case(tmp_path))
    reduced_model = problem.reduced_model
    tried = 0
    for i, parameter in enumerate(problem.parameters):
        if parameter.kind not in ("stiffness", "mass", "tension"):
            continue
        theta = np.zeros(len(reduced_model.changes))
        theta[i] = 0.02
        M, _, K = (part[0] for part in reduced_model.matrices(theta[None])[:3])
        ours = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.clip(0.0))
        base = np.sqrt(np.linalg.eigvals(np.linalg.solve(reduced_model.M, reduced_model.K)).real.clip(0.0))
        rebuilt = problem.adjusted(theta).linearise().eigen[0]
        nominal = problem.plant.linearise().eigen[0]
        lowest = slice(0, 4)
        shift = np.sort(ours)[lowest] - np.sort(base)[lowest]
        near = [np.argmin(np.abs(nominal - w)) for w in np.sort(base)[lowest]]
        exact = rebuilt[near] - nominal[near]
        # second order in 0.02, and the modes that are left out
        np.testing.assert_allclose(shift, exact, atol=0.05 * np.abs(exact).max() + 1e-4, err_msg=parameter.name)
        tried += 1
    assert tried >= 3


def test_a_role_without_recordings_is_refused(short):
    with pytest.raises(BadCase, match="no \\[\\[recording\\]\\] has the role nowhere"):
        prepare(short(), ("nowhere",))
