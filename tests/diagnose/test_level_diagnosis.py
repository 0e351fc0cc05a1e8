"""Diagnosis from responses and modal tables at several levels: nonlinear effects by name and place."""

import numpy as np
import pytest
from level_rigs import LAWS, TWO, write_levels, write_noise

from vlab.cases import load_case
from vlab.diagnose.data.amplitude_dependence import level_notes
from vlab.diagnose.data.responses import read_measured
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.validation.frequency import checked_again
from vlab.physics.catalogue import EFFECTS
from vlab.views.reports.diagnosis import write_diagnosis

FEW = [EFFECTS[n] for n in ("viscous-damping", "coulomb-friction", "cubic-stiffness")]
MORE = [
    *FEW,
    *(EFFECTS[n] for n in ("stiffness-to-ground", "lost-stiffness", "quadratic-drag", "jenkins-slip")),
]


@pytest.mark.slow
def test_dry_friction_is_named_placed_sized_and_verified_from_levels(tmp_path):
    write_levels(tmp_path / "case", LAWS["coulomb"])
    done = diagnose(load_case(tmp_path / "case"), effects=FEW)
    diagnosis = done.diagnosis
    assert diagnosis.verdict == "missing-physics"
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place) == ("coulomb-friction", "joint:mass2")
    assert finding.parameters["force"]["value"] == pytest.approx(0.2, rel=0.05)
    assert diagnosis.heldout["verified"]
    assert diagnosis.heldout["gap_closed"] > 0.8
    assert any("dry friction" in note for note in diagnosis.notes)
    (tmp_path / "out").mkdir()
    write_diagnosis(done, tmp_path / "out")
    again = checked_again(load_case(tmp_path / "out" / "amended.toml"), {c.name for c in diagnosis.checked})
    assert again == pytest.approx(diagnosis.heldout["nrmse_after"], rel=1e-2)


@pytest.mark.slow
def test_a_linear_system_at_several_levels_gives_no_alarm(tmp_path):
    write_levels(tmp_path, LAWS["none"], seed=1)
    diagnosis = diagnose(load_case(tmp_path), effects=FEW).diagnosis
    assert diagnosis.verdict == "nothing-missing"
    assert not diagnosis.findings
    assert any("nothing depends on the amplitude" in note for note in diagnosis.notes)


@pytest.mark.slow
def test_without_levels_nonlinear_effects_are_not_tried_and_the_report_says_so(tmp_path):
    write_levels(tmp_path, LAWS["none"], seed=2)
    path = tmp_path / "case.toml"
    path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith("level")) + "\n")
    diagnosis = diagnose(load_case(tmp_path), effects=FEW).diagnosis
    assert any("nonlinear effects were not tried: state level" in note for note in diagnosis.notes)


def write_tables(folder, k3: float) -> None:
    """Write modal tables of the two masses at four amplitudes, with a cubic spring on the second mass."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.xml").write_text(TWO)
    rng = np.random.default_rng(5)
    relative = np.array([[1.0, 0.0], [-1.0, 1.0]])
    K, C = relative.T @ np.diag([2000.0, 1500.0]) @ relative, relative.T @ relative
    text = ['[model]\nmjcf = "rig.xml"\n[model.uncertain]\nstiffness = 0.02\nmass = 0.02\ndamping = 0.3']
    for i, a in enumerate((0.002, 0.015, 0.03, 0.04)):
        freq, zeta, shapes = [], [], []
        for mode in range(2):
            shape = np.linalg.eigh(K)[1][:, mode]
            for _ in range(20):  # shape and stiffness of the mode at this amplitude of the second mass
                whole = K + np.diag([0.0, 0.75 * k3 * a**2])
                squared, vectors = np.linalg.eigh(whole)
                shape = vectors[:, mode]
            freq.append(np.sqrt(squared[mode]) / (2 * np.pi) * (1 + 0.0005 * rng.standard_normal()))
            zeta.append(shape @ C @ shape / (2 * np.sqrt(squared[mode])) * (1 + 0.05 * rng.standard_normal()))
            shapes.append((shape / np.abs(shape).max() + 0.005 * rng.standard_normal(2)).tolist())
        role = "holdout" if i == 2 else "fit"
        text.append(
            f'[[modal]]\nrole = "{role}"\nfrequency_hz = {np.array(freq).tolist()}\nzeta = {np.array(zeta).tolist()}\n'
            f'at = ["sensor1", "sensor2"]\nshape = {shapes}\nfrequency_sd_hz = {(0.0005 * np.array(freq)).tolist()}\n'
            f"zeta_sd = {(0.05 * np.array(zeta)).tolist()}\nshape_sd = [0.005, 0.005]\n"
            f'amplitude = [{a}, {a}]\namplitude_at = "sensor2"'
        )
    (folder / "case.toml").write_text("\n".join(text) + "\n")


@pytest.mark.slow
def test_modal_tables_at_several_amplitudes_tell_a_cubic_spring(tmp_path):
    write_tables(tmp_path, 4e5)
    diagnosis = diagnose(load_case(tmp_path), effects=FEW[1:]).diagnosis
    assert diagnosis.verdict == "missing-physics"
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place) == ("cubic-stiffness", "joint:mass2")
    assert finding.parameters["k3"]["value"] == pytest.approx(4e5, rel=0.1)
    assert any("rises" in note for note in level_notes(read_measured(load_case(tmp_path), ("fit",))))


# ---- minutes --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_dry_friction_is_found_in_responses_to_noise(tmp_path):
    write_noise(tmp_path, 0.25)
    diagnosis = diagnose(load_case(tmp_path), effects=FEW).diagnosis
    assert diagnosis.verdict == "missing-physics"
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place) == ("coulomb-friction", "joint:mass2")
    assert finding.parameters["force"]["value"] == pytest.approx(0.25, rel=0.1)
    assert any("rms of noise" in note for note in diagnosis.notes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drag", "hardening", "softening", "jenkins"])
def test_laws_are_told_apart_by_levels(tmp_path, name):
    law = LAWS[name]
    write_levels(tmp_path, law)
    diagnosis = diagnose(load_case(tmp_path), effects=MORE).diagnosis
    assert diagnosis.verdict == "missing-physics"
    finding = diagnosis.findings[0]
    assert (finding.effect, finding.place) == (law.effect, law.place)
    for value, p in zip(law.values, EFFECTS[law.effect].parameters, strict=True):
        assert finding.parameters[p.name]["value"] == pytest.approx(value, rel=0.15)
