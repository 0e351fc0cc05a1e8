"""Frequency responses from the columns of files: forms, units, parts of complex numbers, decibels."""

from dataclasses import dataclass

import numpy as np
import pytest
import sound

from vlab.errors import BadRecording, BadUnit, UnknownName
from vlab.recordings import open_table
from vlab.recordings.responses import to_frequency_response
from vlab.recordings.table import Table


@dataclass(frozen=True)
class Column:
    """As `vlab.cases.description.FrfChannelTable`, which is in a room below this one."""

    column: str
    at: str
    imaginary: str = ""
    phase: str = ""
    phase_unit: str = "deg"


@dataclass(frozen=True, kw_only=True)
class Spec:
    form: str = "accelerance"
    form_db: bool = False
    input: str = "floor1"
    outputs: tuple = ("floor1",)
    frequency: str = "f"
    frequency_unit: str = "Hz"
    unit: str = ""
    channel: tuple = ()


# The first lines of the published recordings of a three-storey structure: github Digital-Twin-Operational-Platform,
# Cristallo (BSD-3), Experimental.csv (complex accelerance), Hammer.csv and ExpDataSw.csv (decibels).
EXPERIMENTAL = """\
0.03125+0j;-0.0549712181091309+0.0508308112621307j;-0.0195345804095268-0.0158148948103189j;-0.0493143424391747+0.00578283378854394j
0.0625+0j;-0.0721427574753761-0.0235904511064291j;-0.0639475435018539-0.0639469847083092j;-0.0326197780668736+0.0222943313419819j
0.09375+0j;-0.153468951582909+0.141515806317329j;-0.0705554857850075+0.0489801578223705j;0.00279206223785877+0.00429538451135159j
"""
HAMMER = """\
0.12487499999999999;0.12671679168131572-0.051127465465632654j;0.13790905005077533-0.05097837000076259j;0.12200208065913602-0.051107661823101176j
0.24974999999999997;0.09751361169903078-0.09430498821915803j;0.10874210392581174-0.09404415645313104j;0.09285102108867124-0.09431915602868468j
"""
DECIBELS = """\
0,-16.751,1.1323,-3.7309
0.125,-8.8976,-2.9913,-12.89
0.25,-22.611,-12.113,-22.953
"""
FLOORS = ("floor1", "floor2", "floor3")


def published(tmp_path, text):
    (tmp_path / "run.csv").write_text(text)
    return open_table(tmp_path / "run.csv", names=["f", "H1", "H2", "H3"])


@pytest.mark.parametrize("text", [EXPERIMENTAL, HAMMER])
def test_published_complex_text_is_read(tmp_path, text):
    response = to_frequency_response(published(tmp_path, text), Spec(outputs=FLOORS))
    cells = [[complex(cell) for cell in line.split(";")] for line in text.splitlines()]  # Python's own reading
    np.testing.assert_array_equal(response.H[:, :, 0], np.array(cells)[:, 1:])
    np.testing.assert_array_equal(response.freq, np.array(cells)[:, 0].real)
    assert (response.outputs, response.inputs, response.unit) == (FLOORS, ("floor1",), "m/s^2/N")
    assert not response.is_magnitude


def test_channels_choose_columns_and_the_unit_is_converted(tmp_path):
    spec = Spec(outputs=("top", "base"), channel=(Column("H1", "base"), Column("H3", "top")), unit="in/s^2/lbf")
    response = to_frequency_response(published(tmp_path, EXPERIMENTAL), spec)
    factor = 0.0254 / 4.4482216152605  # exact by definition of inch and pound-force
    assert response.H[1, 0, 0] == pytest.approx((-0.0326197780668736 + 0.0222943313419819j) * factor, rel=1e-14)
    assert response.H[1, 1, 0] == pytest.approx((-0.0721427574753761 - 0.0235904511064291j) * factor, rel=1e-14)


def test_decibels_become_magnitudes_and_are_marked(tmp_path):
    response = to_frequency_response(published(tmp_path, DECIBELS), Spec(outputs=FLOORS, form_db=True))
    assert response.is_magnitude
    assert not response.H.imag.any()
    assert response.H[0, 1, 0].real == pytest.approx(10 ** (1.1323 / 20), rel=1e-15)
    assert any("no phase" in note for note in response.notes)
    assert any("0 Hz" in note for note in response.notes)
    assert response.between(0.1, 0.2).is_magnitude
    with pytest.raises(BadRecording, match="magnitudes only"):
        response.to_frd()


def columns(**more):
    f = np.arange(1.0, 6.0)
    given = {"f": f, "re": np.cos(f), "im": np.sin(f), "H": np.exp(1j * f), "short": f[:3], "back": f[::-1]}
    return Table(path="frf.mat", columns=given | more)


PAIR = Spec(channel=(Column("re", "floor1", "im"),))


@pytest.mark.parametrize("is_db", [False, True])
def test_a_magnitude_with_its_phase_is_a_complex_response(tmp_path, is_db):
    H = np.array([2.0 - 1.0j, -0.3 + 0.4j, 0.1j])
    size = 20 * np.log10(np.abs(H)) if is_db else np.abs(H)
    columns = {"f": np.array([1.0, 2.0, 3.0]), "size": size, "angle": np.angle(H, deg=True), "x": np.angle(H)}
    table = Table(path=tmp_path / "x.csv", columns=columns)
    for phase, unit in (("angle", "deg"), ("x", "rad")):
        channel = (Column("size", "floor1", phase=phase, phase_unit=unit),)
        response = to_frequency_response(table, Spec(form_db=is_db, channel=channel))
        np.testing.assert_allclose(response.H[:, 0, 0], H, rtol=1e-12)
        assert not response.is_magnitude
    some = Spec(form_db=True, outputs=("floor1", "floor2"), channel=(*channel, Column("size", "floor2")))
    if is_db:
        with pytest.raises(BadRecording, match="some outputs have a phase"):
            to_frequency_response(table, some)


def test_pairs_of_columns_are_real_and_imaginary_part():
    response = to_frequency_response(columns(), PAIR)
    np.testing.assert_array_equal(response.H[:, 0, 0], columns()["re"] + 1j * columns()["im"])
    in_rpm = to_frequency_response(columns(), Spec(frequency_unit="kHz", channel=PAIR.channel))
    np.testing.assert_allclose(in_rpm.freq, columns()["f"] * 1000, rtol=1e-15)


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({}, BadRecording, "6 columns beside 'f' for 1 outputs; say with channel"),
        ({"channel": (Column("re", "floor1"),)}, BadRecording, "is real, a response has a phase; name the column of"),
        ({"channel": (Column("H", "floor1", "im"),)}, BadRecording, "'H' is complex"),
        ({"channel": (Column("re", "floor1", "H"),)}, BadRecording, "'H' is complex"),
        ({"channel": (Column("re", "floor1", "short"),)}, BadRecording, "5 lines, its imaginary part 'short' 3"),
        ({"channel": (Column("H", "floor1"),), "frequency": "short"}, BadRecording, "5 lines, the frequencies 3"),
        ({"channel": (Column("H", "floor1"),), "frequency": "back"}, BadRecording, "do not increase"),
        ({"channel": (Column("H", "floor1"),), "frequency": "re"}, BadRecording, "do not increase"),
        ({"channel": (Column("H", "floor1"),), "frequency": "H"}, BadRecording, "'H' is complex"),
        ({"channel": (Column("H", "floor1"),), "form_db": True}, BadRecording, "'H' is complex"),
        ({"channel": (Column("huge", "floor1"),), "form_db": True}, BadRecording, "reaches 1000 dB"),
        ({"channel": (Column("H", "floor2"),)}, BadRecording, "output 'floor1' has no channel"),
        ({"channel": (Column("G", "floor1"),)}, UnknownName, "unknown column 'G'"),
        ({"channel": (Column("H", "floor1"),), "unit": "m/N"}, BadUnit, "dimension"),
        ({"channel": (Column("H", "floor1"),), "unit": "wombat"}, BadUnit, "unknown unit"),
        ({"channel": (Column("H", "floor1"),), "form": "impedance"}, BadRecording, "accepted: receptance, mobility"),
    ],
)
def test_what_does_not_fit_is_refused(change, error, match):
    with pytest.raises(error, match=match):
        to_frequency_response(columns(huge=np.full(5, 1000.0)), Spec(**change))


@pytest.mark.parametrize("is_binary", [False, True])
def test_responses_of_universal_files_state_their_unit(tmp_path, is_binary):
    (tmp_path / "frf.uff").write_bytes(sound.uff(is_binary=is_binary))
    table = open_table(tmp_path / "frf.uff")
    spec = {"outputs": ("y", "z"), "input": "x"}
    response = to_frequency_response(table, Spec(**spec))
    np.testing.assert_array_equal(response.H[:, 1, 0], table["12+Z/1-X"])
    with pytest.raises(BadUnit, match=r"states '\(m/s\^2\)/\(N\)' and the description 'mm/s\^2/N', a factor of 0\.001"):
        to_frequency_response(table, Spec(unit="mm/s^2/N", **spec))
    with pytest.raises(BadUnit, match="another dimension"):
        to_frequency_response(table, Spec(form="mobility", **spec))


def test_complex_columns_come_from_every_format_that_has_them(tmp_path):
    import scipy.io

    scipy.io.savemat(tmp_path / "frf.mat", {"f": np.arange(7.0), "H": np.exp(1j * sound.TIMES)})
    (tmp_path / "frf.npz").write_bytes(sound.npz(f=np.arange(7.0)))
    (tmp_path / "frf.h5").write_bytes(sound.hdf5())
    for name in ("frf.mat", "frf.npz", "frf.h5"):
        table = open_table(tmp_path / name)
        given = Table(path=table.path, columns={"f": np.arange(7.0), "H": table["H"]})
        np.testing.assert_array_equal(to_frequency_response(given, Spec()).H[:, 0, 0], np.exp(1j * sound.TIMES))
