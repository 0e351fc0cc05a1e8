"""What a case says of its frequency responses, beside the model as given: slips are named with the line that mends them."""

import json

import numpy as np
import pytest
from command import run
from frequency_rigs import CHAIN_EFFECTS, write_chain, write_frf

from vlab import units
from vlab.cases import load_case
from vlab.diagnose.predictors.frequency_problem import prepare_frequency
from vlab.diagnose.validation.response_checks import check_responses


def found(folder):
    """Return severities and texts of what is wrong with the responses of a case."""
    return [(f.severity, f.text) for f in check_responses(prepare_frequency(load_case(folder))).found]


def rewritten(folder, change, hidden="none"):
    """Write the case of the chain with other lines (n,) and responses (n, 3) than it says."""
    write_chain(folder, CHAIN_EFFECTS[hidden])
    for role in ("fit", "holdout"):
        path = folder / f"{role}.csv"
        data = np.loadtxt(path, delimiter=",", skiprows=1)
        write_frf(path, *change(data[:, 0], data[:, 1::2] + 1j * data[:, 2::2]))


def edit(folder, old, new):
    """Change every line of a case that reads so."""
    path = folder / "case.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


FORM = 'form = "receptance"'


def s_of(f):
    """Return i omega, (n, 1) [rad/s]."""
    return 2j * np.pi * f[:, None]


SLIPS = {
    "conjugated": (lambda f, H: (f, H.conj()), "conjugate = true", FORM, f"{FORM}\nconjugate = true"),
    "one of three conjugated": (
        lambda f, H: (f, np.where([False, True, False], H.conj(), H)),
        'conjugate = true in every [[frf.channel]] with at = "sensor2"',
        'at = "sensor2"',
        'at = "sensor2"\nconjugate = true',
    ),
    "millimetres": (lambda f, H: (f, 1e3 * H), 'unit = "mm/N" in every [[frf]]', FORM, f'{FORM}\nunit = "mm/N"'),
    "inches": (lambda f, H: (f, H / 0.0254), 'unit = "in/N" in every [[frf]]', FORM, f'{FORM}\nunit = "in/N"'),
    "pounds": (lambda f, H: (f, 4.4482216 * H), 'unit = "m/lbf"', FORM, f'{FORM}\nunit = "m/lbf"'),
    "millimetres of one": (
        lambda f, H: (f, H * [1, 1e3, 1]),
        'scale = 0.001 in every [[frf.channel]] with at = "sensor2"',
        'at = "sensor2"',
        'at = "sensor2"\nscale = 0.001',
    ),
    "mobility": (lambda f, H: (f, s_of(f) * H), 'form = "mobility" in [[frf]]', FORM, 'form = "mobility"'),
    "accelerance": (lambda f, H: (f, s_of(f) ** 2 * H), 'form = "accelerance" in [[frf]]', FORM, 'form = "accelerance"'),
    "rad/s": (lambda f, H: (2 * np.pi * f, H), 'frequency_unit = "rad/s"', FORM, f'{FORM}\nfrequency_unit = "rad/s"'),
    "exchanged": (
        lambda f, H: (f, H[:, [0, 2, 1]]),
        "sensor2 in place of sensor3, and sensor3 in place of sensor2",
        'at = "sensor2"',
        'at = "x"',
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "line", "old", "new"), SLIPS.values(), ids=SLIPS)
def test_a_slip_is_named_with_the_line_that_mends_it(tmp_path, change, line, old, new):
    rewritten(tmp_path, change)
    ((severity, text),) = found(tmp_path)
    assert severity == "fatal"
    assert line in text
    edit(tmp_path, old, new)
    if new == 'at = "x"':
        edit(tmp_path, 'at = "sensor3"', old)
        edit(tmp_path, new, 'at = "sensor3"')
    assert found(tmp_path) == []


def test_of_two_conjugated_outputs_each_is_named_and_the_third_is_not(tmp_path):
    rewritten(tmp_path, lambda f, H: (f, np.where([True, False, True], H.conj(), H)))
    texts = [text for _, text in found(tmp_path)]
    assert [f"sensor{k}" in "".join(texts) for k in (1, 2, 3)] == [True, False, True]
    for k in (1, 3):
        edit(tmp_path, f'at = "sensor{k}"', f'at = "sensor{k}"\nconjugate = true')
    assert found(tmp_path) == []


@pytest.mark.parametrize("hidden", ["added-mass", "lost-stiffness", "absorber"])
def test_a_wrong_form_is_named_although_physics_is_missing_as_well(tmp_path, hidden):
    rewritten(tmp_path, lambda f, H: (f, s_of(f) ** 2 * H), hidden)
    ((severity, text),) = found(tmp_path)
    assert (severity, 'form = "accelerance"' in text) == ("fatal", True)


def test_a_unit_that_is_said_goes_with_the_form(tmp_path):
    rewritten(tmp_path, lambda f, H: (f, 1e3 * s_of(f) * H))
    edit(tmp_path, FORM, f'{FORM}\nunit = "mm/N"')
    ((_, text),) = found(tmp_path)
    line = 'form = "mobility" and unit = "mm/N/s^1"'
    assert line in text
    edit(tmp_path, f'{FORM}\nunit = "mm/N"', line.replace(" and ", "\n"))
    assert found(tmp_path) == []


@pytest.mark.parametrize("outputs", [[-1, -1, -1], [1, -1, 1]])
def test_a_turned_sign_is_a_warning_for_it_may_be_physics(tmp_path, outputs):
    rewritten(tmp_path, lambda f, H: (f, H * outputs))
    ((severity, text),) = found(tmp_path)
    assert severity == "warning"
    assert "scale = -1" in text


@pytest.mark.parametrize("hidden", [name for name in CHAIN_EFFECTS if name != "polarity"])
def test_missing_physics_is_no_slip(tmp_path, hidden):
    write_chain(tmp_path, CHAIN_EFFECTS[hidden])
    assert found(tmp_path) == []


def test_the_command_line_says_why_and_searches_nothing(tmp_path, capsys):
    rewritten(tmp_path, lambda f, H: (f, H.conj()))
    status, out, _ = run(capsys, "diagnose", str(tmp_path))
    assert status == 0
    assert "conjugate = true in [[frf]] with file = fit.csv and holdout.csv" in out
    status, out, _ = run(capsys, "diagnose", str(tmp_path), "--json")
    document = json.loads(out)
    assert (document["verdict"], document["findings"]) == ("bad-recording", [])


def test_of_units_with_one_factor_the_usual_one_comes_first():
    names = list(units.mistaken("m/N", "m/N"))
    assert names.index("mm/N") < names.index("m/kN")


def test_a_case_of_responses_is_checked_before_its_diagnosis(capsys, tmp_path):
    # such a case used to be refused: "only recordings over time are compared here"
    write_chain(tmp_path, CHAIN_EFFECTS["none"], benign=0.0)
    status, out, err = run(capsys, "check", str(tmp_path), "--json")
    document = json.loads(out)
    assert (status, err, document["refused"]) == (0, "", [])
    assert document["next"].startswith("vlab diagnose ")
    rows = {(c["recording"], c["channel"]): c for c in document["channels"]}
    assert len(rows) == 6
    assert any(name == ("frf1", "sensor1 per motor") and c["unit"] == "m/N" for name, c in rows.items())
    assert all(c["correlation"] > 0.99 and c["noise"] < 0.05 * c["recorded_rms"] for c in rows.values())
    status, out, _ = run(capsys, "check", str(tmp_path))
    assert status == 0
    assert "need a [[recording]]" in out


def test_the_check_of_responses_names_slips_and_what_cannot_be_diagnosed(capsys, tmp_path):
    rewritten(tmp_path, lambda f, H: (f, 1e3 * H))
    status, out, _ = run(capsys, "check", str(tmp_path), "--json")
    document = json.loads(out)
    assert status == 0
    assert 'unit = "mm/N"' in document["refused"][0]
    assert "next" not in document
    path = tmp_path / "case.toml"
    path.write_text(path.read_text().replace('role = "fit"', 'role = "holdout"'))
    status, out, _ = run(capsys, "check", str(tmp_path), "--json")
    assert "no [[frf]] and no [[modal]] has the role fit" in json.loads(out)["refused"][0]


def test_modal_tables_are_checked_beside_the_modes_of_the_model(capsys, tmp_path):
    write_chain(tmp_path, CHAIN_EFFECTS["none"])
    path = tmp_path / "case.toml"
    path.write_text(path.read_text().partition("[[frf]]")[0] + '[[modal]]\nrole = "fit"\nfrequency_hz = [2.0, 6.0]\n')
    status, out, _ = run(capsys, "check", str(tmp_path), "--json")
    (words,) = [f["what"] for f in json.loads(out)["findings"] if f["channel"] == "modal1"]
    assert status == 0
    assert "2 modes beside those of the model: the rms difference of the frequency is" in words
