"""``vlab modal-test`` on given frequency responses: a chain of masses in closed form, in every form of file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff
from command import run as run_command
from scipy.io import savemat

import vlab
from vlab.errors import BadRecording, UnknownName
from vlab.modal.mac import mac
from vlab.recordings import open_table
from vlab.recordings.formats.uff import write_uff_response
from vlab.recordings.response_labels import labels_of_pairs
from vlab.signals import FrequencyResponse

HANDED = Path(__file__).parents[3] / "shared" / "cases_from_field" / "frf_uff58_modal_test" / "frf.uff"
G = 9.80665
N, MASS, STIFFNESS = 4, 0.5, 2e5
"""N [1], MASS [kg] and STIFFNESS [N/m] of a chain of equal masses between two walls."""
K = np.arange(1, N + 1)
FREQ = np.sqrt(STIFFNESS / MASS) * np.sin(K * np.pi / (2 * (N + 1))) / np.pi
"""FREQ [Hz]: 2 sqrt(k/m) sin(r pi / 2(n+1)), the natural frequencies of such a chain."""
ZETA = np.array([0.01, 0.006, 0.004, 0.008])
SHAPES = np.sin(np.outer(K, K) * np.pi / (N + 1))
LINES = np.arange(0.0, 501.0) * 0.8


def receptance(freq=LINES, inputs=(1,)):
    """Responses of all masses [m/N], (line, output, input)."""
    omega = 2 * np.pi * freq[:, None]
    modal = 1 / ((2 * np.pi * FREQ) ** 2 - omega**2 + 2j * ZETA * 2 * np.pi * FREQ * omega)
    scaled = SHAPES / np.sqrt(MASS * (N + 1) / 2)  # the sum of sin^2 over the masses is (n+1)/2
    return np.einsum("fr,or,ir->foi", modal, scaled, scaled[[i - 1 for i in inputs]])


def accelerance(freq=LINES, inputs=(1,)):
    return -((2 * np.pi * freq[:, None, None]) ** 2) * receptance(freq, inputs)


def uff_set(H, output, into, freq=LINES, **changes):
    parts = {
        "binary": 0,
        "func_type": 4,
        "rsp_node": output,
        "rsp_dir": 3,
        "ref_node": into,
        "ref_dir": 3,
        "data": H,
        "x": freq,
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 13,
        "z_axis_spec_data_type": 0,
        "ordinate_axis_units_lab": "g",
        "orddenom_axis_units_lab": "N",
        "id1": "chain",
    }
    return pyuff.prepare_58(**(parts | changes))


def write_uff(path, inputs=(1,), outputs=K, freq=LINES, **changes):
    H = accelerance(freq, inputs) / G
    sets = [uff_set(H[:, o - 1, k], o, i, freq, **changes) for k, i in enumerate(inputs) for o in outputs]
    pyuff.UFF(str(path)).write_sets(sets, "add")
    return path


def write_csv(path, names, columns):
    rows = np.column_stack(columns)
    path.write_text(",".join(names) + "\n" + "\n".join(",".join(f"{v:.12g}" for v in row) for row in rows) + "\n")
    return path


@pytest.fixture(autouse=True)
def quick(quick_layout):
    """Figures of pages are not looked at here."""


def run(capsys, *words):
    return run_command(capsys, "modal-test", *(str(word) for word in words))


def modes_of(capsys, *words):
    status, out, err = run(capsys, *words, "--json")
    assert status == 0, err
    return json.loads(out)


def is_the_chain(document):
    modes = document["modes"]
    shapes = np.array([list(mode["shape"].values()) for mode in modes]).T
    assert [m["hz"] for m in modes] == pytest.approx(FREQ, rel=1e-4)
    assert [m["zeta"] for m in modes] == pytest.approx(ZETA, rel=2e-3)
    assert np.diag(mac(shapes, SHAPES)) == pytest.approx(1.0, abs=1e-4)
    return True


def refusal(capsys, *words):
    status, out, err = run(capsys, *words)
    assert status == 2
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    return err


# ------------------------------------------------------------------------------------------------ forms of a file


@pytest.mark.parametrize("binary", [0, 1])
def test_a_universal_file_needs_no_flags(capsys, tmp_path, binary):
    document = modes_of(capsys, write_uff(tmp_path / "frf.uff", binary=binary))
    assert is_the_chain(document)
    assert list(document["modes"][0]["shape"]) == ["1+Z", "2+Z", "3+Z", "4+Z"]
    assert document["frf"][0]["inputs"] == ["1+Z"]
    assert document["frf"][0]["unit"] == "(m/s^2)/N"
    measured = np.array(document["frf"][0]["real"]) + 1j * np.array(document["frf"][0]["imag"])
    assert measured == pytest.approx(accelerance()[1:], rel=1e-4, abs=1e-5)  # text of 6 digits; 0 Hz is left out
    assert document["signals"] == []
    assert document["notes"] == []


@pytest.mark.skipif(not HANDED.exists(), reason="the handed case is not here")
def test_the_handed_case(capsys):
    document = modes_of(capsys, HANDED)
    assert [m["hz"] for m in document["modes"]] == pytest.approx([3.044, 77.71, 158.64, 215.44, 255.79], rel=1e-3)
    assert [m["zeta"] for m in document["modes"]] == pytest.approx([0.01, 0.006, 0.004, 0.005, 0.007], rel=0.05)
    assert all(len(mode["shape"]) == 5 for mode in document["modes"])


def complex_csv(path):
    H = accelerance()[:, :, 0] / G
    cells = [[f"{v.real:.12g}{v.imag:+.12g}j" for v in column] for column in H.T]
    head = ",".join(["Frequency [Hz]", *(f"acc{o}/hammer [g/N]" for o in K)])
    rows = zip((f"{f:g}" for f in LINES), *cells, strict=True)
    path.with_suffix(".csv").write_text(head + "\n" + "\n".join(map(",".join, rows)) + "\n")
    return path.with_suffix(".csv")


def real_pairs(path):
    H = 1e3 * (2j * np.pi * LINES * receptance()[:, :, 0].T).T  # mobility in mm/s/N
    names, columns = ["freq_Hz"], [LINES]
    for o in K:
        names += [f"v{o}/hammer real [mm/s/N]", f"v{o}/hammer imag [mm/s/N]"]
        columns += [H[:, o - 1].real, H[:, o - 1].imag]
    return write_csv(path.with_suffix(".csv"), names, columns)


def magnitudes(path):
    H = 1e6 * receptance()[:, :, 0]
    names, columns = ["omega [rad/s]"], [2 * np.pi * LINES]
    for o in K:
        names += [f"x{o}/hammer mag (um/N)", f"x{o}/hammer phase (rad)"]
        columns += [np.abs(H[:, o - 1]), np.angle(H[:, o - 1])]
    return write_csv(path.with_suffix(".csv"), names, columns)


def npz(path):
    np.savez(path.with_suffix(".npz"), f=LINES, H=receptance()[:, :, 0])
    return path.with_suffix(".npz")


def mat(path):
    savemat(path.with_suffix(".mat"), {"run": {"f": LINES, "H": receptance()[:, :, 0]}})
    return path.with_suffix(".mat")


NAMED = [f"--output={name}=displacement,m" for name in ("H_1", "H_2", "H_3", "H_4")]
STRUCT = [f"--output={name}=displacement,m" for name in ("run.H_1", "run.H_2", "run.H_3", "run.H_4")]


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (complex_csv, []),
        (real_pairs, []),
        (magnitudes, ["--frequency", "omega [rad/s]"]),
        (npz, ["--input", "hammer=force,N", *NAMED]),
        (mat, ["--input", "hammer=force,N", *STRUCT]),
    ],
)
def test_columns_of_any_form(capsys, tmp_path, write, words):
    document = modes_of(capsys, write(tmp_path / "frf"), *words)
    assert is_the_chain(document)
    assert document["frf"][0]["inputs"] == ["hammer"]


def test_decibels_with_a_phase_in_degrees(capsys, tmp_path):
    H = accelerance()[1:, 1, 0] / G
    columns = [LINES[1:], 20 * np.log10(np.abs(H)), np.degrees(np.angle(H))]
    path = write_csv(tmp_path / "frf.csv", ["f", "Magnitude [dB]", "Phase"], columns)
    words = (path, "--input", "hammer=force,N", "--output", "response=acceleration,g")
    document = modes_of(capsys, *words)
    assert [m["hz"] for m in document["modes"]] == pytest.approx(FREQ, rel=1e-4)
    assert [m["zeta"] for m in document["modes"]] == pytest.approx(ZETA, rel=2e-3)
    assert "the quantity of its output is not known; name it, such as --output response=acceleration,g" in refusal(
        capsys, path
    )
    turned = write_csv(tmp_path / "rad.csv", ["f", "Magnitude [dB]", "Phase"], [*columns[:2], np.angle(H)])
    assert "'Phase' reaches 3.14 and states no unit; name its unit in the file" in refusal(capsys, turned, *words[1:])


def test_an_array_of_outputs_and_inputs(capsys, tmp_path):
    path = tmp_path / "frf.npz"
    np.savez(path, f=LINES, H=receptance(inputs=(1, 2)))
    sides = [word for o in K for word in ("--output", f"{o}=displacement,m")]
    document = modes_of(capsys, path, *sides, "--input", "1=force,N", "--input", "2=force,N")
    assert is_the_chain(document)
    assert [frf["inputs"] for frf in document["frf"]] == [["1"], ["2"]]


def test_vlab_reads_its_own_universal_file(tmp_path):
    frf = FrequencyResponse(freq=LINES, H=receptance(), outputs=("a", "b", "c", "d"), inputs=("f",), unit="m/N")
    write_uff_response(frf, tmp_path / "own.uff")
    result = vlab.modal_test(tmp_path / "own.uff")
    assert result.poles.freq == pytest.approx(FREQ, rel=1e-6)
    assert result.mean.outputs == ("1", "2", "3", "4")


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (["Re(2+Z/1+Z)", "Im(2+Z/1+Z)"], [("2+Z", "1+Z")]),
        (["H.real", "H.imag"], [("H", "")]),
        (["acc_mag", "acc_phase", "acc2_mag"], [("acc", "")]),
        (["a Amplitude", "a Phase", "joint angle"], [("a", "")]),
        (["real_H", "imag_H", "remain", "imp"], [("H", "")]),
    ],
)
def test_pairs_of_columns_by_their_names(names, labels):
    assert [(label.output, label.input) for label in labels_of_pairs(names, {}, [])] == labels


# ------------------------------------------------------------------------------------------------- several files


@pytest.mark.slow
def test_a_file_for_each_blow_point(capsys, tmp_path):
    paths = [write_uff(tmp_path / f"blow{i}.uff", inputs=(i,)) for i in (1, 3)]
    document = modes_of(capsys, *paths)
    assert is_the_chain(document)
    assert list(document["modes"][0]["dwell"]["forces"]) == ["1+Z", "3+Z"]
    assert is_the_chain(modes_of(capsys, *paths, "--input", "3+Z"))


def test_a_file_for_each_response_and_a_point_measured_twice(capsys, tmp_path):
    paths = [write_uff(tmp_path / f"point{o}.uff", outputs=(o,)) for o in K]
    again = write_uff(tmp_path / "again.uff", outputs=(1,))
    assert is_the_chain(modes_of(capsys, *paths))
    assert is_the_chain(modes_of(capsys, *paths, again))
    whole = write_uff(tmp_path / "whole.uff", outputs=(*K, 1))
    document = modes_of(capsys, whole)
    assert is_the_chain(document)
    assert document["notes"] == ["whole.uff: 2 responses of 1+Z to 1+Z are averaged."]


def test_accelerations_and_velocities_together(capsys, tmp_path):
    path = write_uff(tmp_path / "frf.uff", outputs=(1, 2))
    H = 2j * np.pi * LINES[:, None] * receptance()[:, 2:, 0]
    labels = {"ordinate_axis_units_lab": "m/s", "ordinate_spec_data_type": 11}
    sets = [uff_set(H[:, k], o, 1, **labels) for k, o in enumerate((3, 4))]
    pyuff.UFF(str(path)).write_sets(sets, "add")
    assert is_the_chain(modes_of(capsys, path))


@pytest.mark.slow
def test_a_roving_hammer_gives_the_shape_at_the_blows(capsys, tmp_path):
    paths = [write_uff(tmp_path / f"blow{i}.uff", inputs=(i,), outputs=(1,)) for i in K]
    document = modes_of(capsys, *paths)
    shapes = np.array([list(mode["input_shape"].values()) for mode in document["modes"]]).T
    assert [m["hz"] for m in document["modes"]] == pytest.approx(FREQ, rel=1e-4)
    assert np.diag(mac(shapes, SHAPES)) == pytest.approx(1.0, abs=1e-4)
    status, text, _ = run(capsys, *paths, "--out", tmp_path / "out")
    assert status == 0
    assert "shapes at the inputs, from the participation of each input (reciprocity)" in text
    assert "Shapes at the inputs" in (tmp_path / "out" / "report.html").read_text()


def test_a_missing_response_is_named(capsys, tmp_path):
    paths = write_uff(tmp_path / "a.uff"), write_uff(tmp_path / "b.uff", inputs=(2,), outputs=(1, 2, 4))
    assert "the response of 3+Z to 2+Z is missing; give it, or name common outputs with --output" in refusal(
        capsys, *paths
    )
    document = modes_of(capsys, *paths, *(f"--output={o}+Z" for o in (1, 2, 4)))
    assert [m["hz"] for m in document["modes"]] == pytest.approx(FREQ, rel=1e-4)


@pytest.mark.slow
def test_uneven_frequencies(capsys, tmp_path):
    freq = np.unique(np.concatenate([np.arange(20.0, 400.0, 4.0), *(f + np.linspace(-5, 5, 41) for f in FREQ)]))
    path = write_uff(tmp_path / "frf.uff", freq=freq, abscissa_spacing=0)
    assert is_the_chain(modes_of(capsys, path))


def test_other_functions_of_a_universal_file_are_no_responses(capsys, tmp_path):
    path = tmp_path / "all.uff"
    coherence = uff_set(np.full(LINES.size, 0.99), 2, 1, func_type=6)
    cross = uff_set(accelerance()[:, 0, 0] * 1e3, 2, 1, func_type=3)
    pyuff.UFF(str(path)).write_sets([coherence, cross], "add")
    assert is_the_chain(modes_of(capsys, write_uff(path)))


# ---------------------------------------------------------------------------------------------- units and refusals


def test_units_by_the_user(capsys, tmp_path):
    bare = {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": "NONE"}
    path = write_uff(tmp_path / "bare.uff", ordinate_spec_data_type=0, orddenom_spec_data_type=0, **bare)
    words = ["--input", "1+Z=force,N", *(w for o in K for w in ("--output", f"{o}+Z=acceleration,g"))]
    document = modes_of(capsys, path, *words)
    assert is_the_chain(document)
    assert document["frf"][0]["real"][50][0][0] == pytest.approx(accelerance()[51, 0, 0].real, rel=1e-4)
    said = refusal(capsys, path)
    assert "bare.uff: column '1+Z/1+Z' has no unit: the quantity of its output is not known" in said
    assert "name it, such as --output 1+Z=acceleration,g" in said
    stated = write_uff(tmp_path / "stated.uff")
    said = refusal(capsys, stated, "--output", "2+Z=acceleration,m/s^2")
    assert "states '(g)/(N)' and the description '(m/s^2)/(N)', a factor of 0.101972" in said
    assert "header states output velocity and the unit 'g', of acceleration" in refusal(
        capsys, write_uff(tmp_path / "lying.uff", ordinate_spec_data_type=11)
    )


def test_a_header_with_a_quantity_and_no_unit(capsys, tmp_path):
    path = write_uff(tmp_path / "bare.uff", ordinate_axis_units_lab="NONE", orddenom_axis_units_lab="NONE")
    document = modes_of(capsys, path)
    assert is_the_chain(document)
    assert document["notes"][0].startswith("bare.uff states acceleration without a unit: m/s^2 is taken;")
    assert "m/s^2 is taken" in run(capsys, path)[1]
    pyuff.UFF(str(path)).write_sets([uff_set(accelerance()[:, 1, 0] / G, 7, 1)], "add")
    assert "column '1+Z/1+Z' states no unit, and other responses do" in refusal(capsys, path)


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("--time", "f"), "frequency responses have no time; leave out --time"),
        (("--rate", "100"), "frequency responses have no rate; leave out --rate"),
        (("--segment", "1"), "segment_s belongs to records in time"),
        (("--estimator", "H2"), "estimator belongs to records in time"),
        (("--window-end", "0.5"), "end_level belongs to records in time"),
        (("--output", "9+Z"), "unknown output '9+Z'"),
        (("--input", "9+Z"), "unknown input '9+Z'"),
        (("--frequency", "nu"), "unknown column 'nu'"),
        (("--input", "1+Z=other"), "input '1+Z' is of kind 'other'; accepted: force, moment"),
        (("--band", "600", "700"), "0 usable lines between 600 and 700 Hz"),
        (("--against-plant",), "--against-plant needs run folders"),
    ],
)
def test_refused_settings(capsys, tmp_path, words, match):
    assert match in refusal(capsys, write_uff(tmp_path / "frf.uff"), *words)


def test_records_and_responses_are_not_mixed(capsys, tmp_path):
    t = np.arange(500) / 100
    time = write_csv(tmp_path / "time.csv", ["time", "hammer", "acc"], [t, np.sin(t), np.cos(t)])
    said = refusal(capsys, write_uff(tmp_path / "frf.uff"), time)
    assert f"{time} holds records in time and {tmp_path / 'frf.uff'} frequency responses" in said


def test_damaged_lines(capsys, tmp_path):
    H = accelerance()[:, 0, 0]

    def written(freq):
        names = ["f", "a/b real [m/s^2/N]", "a/b imag [m/s^2/N]"]
        return write_csv(tmp_path / "frf.csv", names, [freq, H.real[: len(freq)], H.imag[: len(freq)]])

    assert "'f' has one line, at 3 Hz; a response has at least 2 lines" in refusal(capsys, written([3.0]))
    assert "5 usable lines" in refusal(capsys, written(np.arange(1.0, 6.0)))
    assert "lines 2 and 3 both are at 2 Hz; keep one of the lines" in refusal(capsys, written([0.0, 1.0, 2.0, 2.0]))
    assert "do not increase from 0 on (line 2 is 0.5 Hz)" in refusal(capsys, written([0.0, 1.0, 0.5]))
    assert "do not increase from 0 on (line 0 is -1 Hz)" in refusal(capsys, written([-1.0, 0.0, 1.0]))


def test_magnitudes_alone_have_no_poles(capsys, tmp_path):
    path = write_csv(tmp_path / "frf.csv", ["f", "a [dB]"], [LINES[1:], np.abs(accelerance()[1:, 0, 0])])
    said = refusal(capsys, path)
    assert "no frequency response with magnitude and phase among the columns; give complex columns, or pairs" in said


def test_files_that_do_not_name_their_input(capsys, tmp_path):
    H = accelerance()[:, 0, 0]
    names = ["f", "a real [m/s^2/N]", "a imag [m/s^2/N]"]
    paths = [write_csv(tmp_path / f"{k}.csv", names, [LINES, H.real, H.imag]) for k in range(2)]
    assert modes_of(capsys, paths[0])["frf"][0]["inputs"] == ["force"]
    assert "the file does not name the input of its responses; name it with --input" in refusal(capsys, *paths)
    document = modes_of(capsys, *paths, "--input", "hammer")
    assert [m["hz"] for m in document["modes"]] == pytest.approx(FREQ, rel=1e-4)


def test_a_file_with_records_and_responses(tmp_path):
    t = np.arange(4000) / 1000
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "both.npz", time=t, x=rng.standard_normal(t.size), y=rng.standard_normal(t.size), H=1j * t)
    with pytest.raises(BadRecording, match="no column is named f or frequency; name it with frequency="):
        vlab.modal_test(tmp_path / "both.npz")
    with pytest.raises(BadRecording, match="no mode found"):  # read as records in time
        vlab.modal_test(tmp_path / "both.npz", inputs=["x=force,N"], outputs=["y=displacement,m"])


# ------------------------------------------------------------------------------------------------ Python and report


def test_responses_from_python(tmp_path):
    names = tuple("abcd")
    frf = FrequencyResponse(freq=LINES, H=accelerance() / G, outputs=names, inputs=("hammer",), unit="g/N")
    result = vlab.modal_test(frf)
    assert result.poles.freq == pytest.approx(FREQ, rel=1e-6)
    assert result.poles.zeta == pytest.approx(ZETA, rel=1e-4)
    assert result.mean.unit == "m/N"
    np.testing.assert_allclose(result.mean.H, receptance()[1:], rtol=1e-9)
    path = write_uff(tmp_path / "frf.uff", inputs=(3,))
    both = vlab.modal_test([replace(frf, outputs=("1+Z", "2+Z", "3+Z", "4+Z")), path], outputs=["2+Z", "4+Z"])
    assert both.mean.inputs == ("hammer", "3+Z")
    assert both.mean.outputs == ("2+Z", "4+Z")
    with pytest.raises(BadRecording, match=r"unit ''; accepted: a motion per force"):
        vlab.modal_test(replace(frf, unit=""))
    with pytest.raises(UnknownName, match="unknown output 'z'"):
        vlab.modal_test(frf, outputs=["z"])


def test_a_shaken_base_drives_by_its_acceleration():
    base = -receptance(inputs=(1,))  # poles of the chain, whatever the scale
    frf = FrequencyResponse(freq=LINES, H=base, outputs=tuple("abcd"), inputs=("table",), unit="g/g")
    result = vlab.modal_test(frf)
    assert result.mean.unit == "m/(m/s^2)"
    assert result.poles.freq == pytest.approx(FREQ, rel=1e-4)


@pytest.mark.slow
def test_the_report_says_only_what_is_true_of_given_responses(capsys, tmp_path):
    status, text, _ = run(capsys, write_uff(tmp_path / "frf.uff"), "--out", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert status == 0
    assert text.startswith("input 1+Z; 4 given responses; 500 lines; residual of the fit")
    assert "4 given frequency responses; inputs: 1+Z." in page
    for part in ("Stabilisation", "Mode shapes", "measured and fitted"):
        assert part in page
    for word in ("excitation", "coherence", "recording", "average"):
        assert word not in (text + page).lower()
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"stabilisation.svg", "frf-1+Z.svg", "frf-4+Z.svg", "manifest.json"}


def test_a_table_keeps_what_the_header_states(tmp_path):
    table = open_table(write_uff(tmp_path / "frf.uff", rsp_dir=5, ordinate_axis_units_lab="rad/s^2"))
    label = table.responses[0]
    assert (label.output, label.input, label.motion, label.drive) == ("1+RY", "1+Z", "angular-acceleration", "force")
