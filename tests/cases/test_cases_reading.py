"""case.toml is read strictly, and every name in it is checked against the model."""

import pickle

import numpy as np
import pytest

from vlab.cases import load_case
from vlab.cases.description import ChannelTable
from vlab.errors import BadCase, BadRecording, BadStructure, UnknownName, VlabError

RIG = """
<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="cart">
  <joint name="x" type="slide" axis="1 0 0" stiffness="400"/><geom name="block" size="0.05" mass="1"/><site name="end"/>
</body></worldbody>
<actuator><motor name="coil" joint="x"/><motor name="geared" joint="x" gear="3"/></actuator>
<sensor><jointpos name="laser" joint="x"/><jointvel name="pickup" joint="x"/><framepos name="end" objtype="site" objname="end"/></sensor>
</mujoco>
"""

CASE = """
title = "cart"
[model]
mjcf = "rig.xml"
[model.uncertain]
stiffness = 0.05
"geom:block:mass" = 0.02
[[recording]]
file = "run.csv"
role = "fit"
time = "t"
[[recording.channel]]
column = "u"
at = "coil"
kind = "command"
unit = "N"
input = true
[[recording.channel]]
column = "x"
at = "laser"
kind = "displacement"
unit = "mm"
[recording.controller]
sensors = ["pickup"]
actuators = ["coil"]
gains = [[2.0]]
gains_unit = "lbf s/in"
rate_hz = 500.0
"""

OBSERVER = """[recording.controller]
sensors = ["laser"]
actuators = ["coil"]
rate_hz = 500.0
A = [[0.9]]
B = [[0.1]]
C = [[1.0]]
K = [[2.0]]
M = [[0.1]]
"""

MORE = """
[[frf]]
file = "run.csv"
role = "fit"
form = "accelerance"
input = "coil"
outputs = ["laser"]
[[frf.channel]]
column = "H"
at = "laser"
[[modal]]
role = "fit"
frequency_hz = [3.2]
zeta = [0.01]
at = ["laser"]
shape = [[1.0]]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.xml").write_text(RIG)
    t = np.arange(50) / 500
    np.savetxt(
        tmp_path / "run.csv", np.column_stack([t, np.sin(t), np.cos(t)]), delimiter=",", header="t,u,x", comments=""
    )
    (tmp_path / "case.toml").write_text(CASE)
    return tmp_path


def change(folder, old, new):
    text = (folder / "case.toml").read_text()
    assert old in text
    (folder / "case.toml").write_text(text.replace(old, new))


def test_a_case_is_read_labelled_and_wired(folder):
    (folder / "case.toml").write_text(CASE + MORE)
    case = load_case(folder)
    (run,) = case.runs(("fit",))
    assert run.measured.names == ("coil", "laser")
    assert run.measured["laser"][0] == pytest.approx(1e-3)  # mm to m
    assert run.drives[0].actuator == 0
    assert run.compared[0].sensor == 0
    # u = -D y with D = 2 lbf s/in = 2 x 4.4482216 N / 0.0254 m: exact by definition of pound-force and inch
    u = run.law.step(np.array([0.0, 1.0, 0.0, 0.0, 0.0]))
    assert u[0] == pytest.approx(-2 * 4.4482216152605 / 0.0254, rel=1e-12)
    assert case.table.frf[0].channel[0].column == "H"
    assert case.table.modal[0].shape == ((1.0,),)
    assert case.runs(("holdout",)) == []


@pytest.mark.parametrize(
    ("word", "unit", "kind"),
    [
        ("position", "mm", "displacement"),
        ("position", "deg", "angle"),
        ("speed", "rad/s", "angular-velocity"),
        ("torque", "N m", "moment"),
        ("Angular velocity", "deg/s", "angular-velocity"),
        ("angular_acceleration", "rad/s^2", "angular-acceleration"),
    ],
)
def test_other_words_for_a_kind_are_understood(word, unit, kind):
    channel = ChannelTable(column="x", at="laser", kind=word, unit=unit)
    assert channel.kind == kind
    assert channel.spec().kind == kind


def test_a_case_may_be_any_file_so_that_several_share_a_folder(folder):
    (folder / "case.toml").rename(folder / "second.toml")
    assert load_case(folder / "second.toml").table.title == "cart"
    with pytest.raises(BadCase, match=r"case\.toml"):
        load_case(folder)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("title =", "titel =", "unknown key 'titel'; did you mean 'title'"),
        ('kind = "command"', 'kin = "command"', r"recording\[0\]\.channel\[0\]: unknown key 'kin'"),
        ("gains_unit", "gain_unit", "did you mean 'gains_unit'"),
        ('mjcf = "rig.xml"', "", "either mjcf"),
        ('mjcf = "rig.xml"', 'mjcf = "rig.xml"\nstructure = "beam"', "either mjcf"),
        ('mjcf = "rig.xml"', 'mjcf = "other.xml"', "model.mjcf: there is no file 'other.xml'"),
        ('mjcf = "rig.xml"', 'mjcf = "../rig.xml"', "model.mjcf.*outside"),
        ('mjcf = "rig.xml"', 'mjcf = "rig.xml"\nvariant = "physical"', "belongs to a structure"),
        ('mjcf = "rig.xml"', 'structure = "bean"', "unknown structure 'bean'; did you mean 'beam'"),
        ("stiffness = 0.05", "stifness = 0.05", "did you mean 'stiffness'"),
        ("stiffness = 0.05", "stiffness = -0.05", "above 0"),
        ("geom:block:mass", "geom:blok:mass", "unknown geom 'blok'; did you mean 'block'"),
        ("geom:block:mass", "gem:block:mass", "unknown type of element 'gem'"),
        ("geom:block:mass", "geom:block", "type:name:quantity"),
        ('role = "fit"', 'role = "test"', "fit, holdout"),
        ('file = "run.csv"', 'file = "run2.csv"', "there is no file 'run2.csv'"),
        ('file = "run.csv"', 'file = "/etc/hostname"', "outside the case's folder"),
        ('file = "run.csv"', 'file = "../run.csv"', "outside the case's folder"),
        ('file = "run.csv"', 'file = "a\\u0000b"', "no file name"),
        ('time = "t"', "", "rate_hz, or time"),
        ('time = "t"', 'time = "t"\nrate_hz = 5.0', "rate_hz, or time"),
        ('time = "t"', 'time = "t"\ntime_unit = "m"', "cannot be converted to 's'"),
        ('time = "t"', 'time = "t"\nstart_s = 2.0\nstop_s = 1.0', "the start must come first"),
        ('at = "laser"', 'at = "lazer"', "unknown sensor 'lazer'; did you mean 'laser'"),
        ('at = "laser"', 'at = "end"', "several values; say one of end.x, end.y, end.z"),
        ('at = "laser"', 'at = "pickup"', "gives velocity, the column 'x' is displacement"),
        ('at = "coil"', 'at = "coli"', "unknown actuator 'coli'; did you mean 'coil'"),
        ('unit = "N"', 'unit = "V"', "takes N, the column 'u' is in V; give scale = N per V"),
        ('unit = "mm"', 'unit = "V"', "cannot be converted to 'm'.*the kind is 'voltage', not 'displacement'"),
        ('unit = "mm"', 'unit = "deg"', "the kind is 'angle', not 'displacement'"),
        (
            'kind = "displacement"\nunit = "mm"',
            'kind = "position"',
            "may be 'displacement' or 'angle'; say which, or give the unit",
        ),
        ('kind = "displacement"', 'kind = "places"', "unknown kind of channel 'places'.*accepted"),
        ("input = true\n", 'at = "geared"\n', "malformed TOML"),
        ('unit = "N"\ninput = true', 'unit = "N"\nname = "laser"\ninput = true', "two channels are called 'laser'"),
        ('sensors = ["pickup"]', 'sensors = ["pickop"]', "recording.0..controller: unknown sensor 'pickop'"),
        ('actuators = ["coil"]', 'actuators = ["foil"]', "unknown actuator 'foil'"),
        ('actuators = ["coil"]', 'actuators = ["geared"]', "takes a bare command; say in which unit"),
        ("[[2.0]]", "[[2.0, 1.0]]", "1 rows .actuators. of 1 numbers"),
        ("[[2.0]]", "[[nan]]", "finite"),
        ('gains_unit = "lbf s/in"', 'gains_unit = "lbf/in"', "cannot be converted"),
        ("gains = [[2.0]]", "A = [[1.0]]", "missing: B, C, K, M"),
        ("gains = [[2.0]]", "gains = [[2.0]]\nlimit = 3.0", "limit belongs to the observer"),
        ("rate_hz = 500.0", "rate_hz = 0.0", "must be positive"),
        (
            'at = "coil"\nkind = "command"\nunit = "N"',
            'at = "joint:x"\nkind = "displacement"\nunit = "mm"',
            "to prescribe a motion, give the model a stiff <position>",
        ),
        ('time = "t"', "rate_hz = 1e15", "rate_hz is 1e.15; it must be positive and at most 1e.09"),
        ('unit = "mm"', 'unit = "mm"\nscale = 1e300', "no such unit is that far off"),
        ('unit = "mm"', 'unit = "mm"\noffset = inf', "it must be finite"),
        ('unit = "mm"', 'unit = "mm"\nnoise = 0.0', "noise is 0; it must be a positive standard deviation in mm"),
        ('unit = "mm"', 'unit = "mm"\nnoise = inf', "it must be finite"),
        (
            'kind = "command"\nunit = "N"',
            'kind = "command"\nunit = "N"\nnoise = 0.1',
            "noise is for what is compared with the model",
        ),
        ("title", "= =", "malformed TOML"),
    ],
)
def test_mistakes_are_refused_with_where_and_what_is_accepted(folder, old, new, match):
    change(folder, old, new)
    with pytest.raises(VlabError, match=match) as caught:
        load_case(folder)
    assert isinstance(caught.value, BadCase)
    assert "case.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('outputs = ["laser"]', 'outputs = ["laser", "lazer"]', "2|channel has 1"),
        ('column = "H"\nat = "laser"', 'column = "H"\nat = "lser"', "unknown output 'lser'"),
        ('input = "coil"', 'input = "koil"', r"frf\[0\]: unknown sensor 'koil'; did you mean 'coil'"),
        ('form = "accelerance"', 'form = "inertance"', "accelerance"),
        ('column = "H"', 'column = "H"\nimaginary = "I"\nphase = "p"', "both imaginary and phase"),
        ("zeta = [0.01]", "zeta = [1.5]", "not a percentage"),
        ("zeta = [0.01]", "zeta = [0.01, 0.02]", "zeta has 2 entries"),
        ("shape = [[1.0]]", "shape = [[1.0, 2.0]]", "a row of shape has 2"),
        ('at = ["laser"]', 'at = ["lasr"]', r"modal\[0\]\.at: unknown sensor 'lasr'"),
    ],
)
def test_frequency_responses_and_modes_are_checked_too(folder, old, new, match):
    (folder / "case.toml").write_text(CASE + MORE)
    change(folder, old, new)
    with pytest.raises(BadCase, match=match):
        load_case(folder)


def test_what_a_file_reads_at_rest_is_taken_off(folder):
    plain = load_case(folder).runs()[0].measured["laser"]
    change(folder, 'unit = "mm"', 'unit = "mm"\noffset = 50.0')
    np.testing.assert_allclose(load_case(folder).runs()[0].measured["laser"], plain - 0.05)


def test_stated_noise_is_in_the_unit_of_the_file(folder):
    assert load_case(folder).runs()[0].compared[0].noise is None
    change(folder, 'unit = "mm"', 'unit = "mm"\nnoise = 0.3')
    (one,) = (c for c in load_case(folder).runs()[0].compared if c.channel == "laser")
    assert one.noise == pytest.approx(3e-4)
    change(folder, "noise = 0.3", "noise = 0.3\nscale = -0.002")
    (one,) = (c for c in load_case(folder).runs()[0].compared if c.channel == "laser")
    assert one.noise == pytest.approx(6e-4)


def test_samples_are_not_fitted_and_held_out(folder):
    table = CASE[CASE.index("[[recording]]") : CASE.index("[recording.controller]")].replace('"fit"', '"holdout"')
    (folder / "case.toml").write_text(CASE + table)
    with pytest.raises(BadCase, match="held out and fitted, too"):
        load_case(folder)
    parts = (CASE + table.replace('time = "t"', 'time = "t"\nstart_s = 0.06')).replace(
        'time = "t"', 'time = "t"\nstop_s = 0.06', 1
    )
    (folder / "case.toml").write_text(parts)
    assert len(load_case(folder).runs()) == 2


def test_a_command_is_compared_only_where_a_law_gives_one(folder):
    change(folder, "input = true", "")
    assert load_case(folder).runs()[0].compared[0].actuator == 0
    change(folder, CASE[CASE.index("[recording.controller]") :], "")
    with pytest.raises(BadCase, match="no law commands; say input = true"):
        load_case(folder)


def test_the_observer_form_takes_units_and_a_limit(folder):
    text = (
        CASE[: CASE.index("[recording.controller]")]
        + OBSERVER
        + 'sensor_unit = "mm"\nactuator_scale = 4.0\nlimit = 5.0\n'
    )
    (folder / "case.toml").write_text(text)
    law = load_case(folder).runs()[0].law
    law.step(np.array([1.0, 0, 0, 0, 0]))  # 1 m = 1000 mm: x = M y = 100
    assert law.step(np.zeros(5))[0] == pytest.approx(-5.0 * 4.0)  # -K x = -200 is limited to 5, and 4 N per unit


def test_a_pickle_is_never_opened(folder):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("a pickle was executed",))

    (folder / "run.pkl").write_bytes(pickle.dumps(Trap()))
    change(folder, "run.csv", "run.pkl")
    with pytest.raises(BadRecording, match=r"'\.pkl' are not read"):
        load_case(folder).runs()
    (folder / "run.csv").write_bytes(pickle.dumps(Trap()))
    change(folder, "run.pkl", "run.csv")
    with pytest.raises(VlabError):
        load_case(folder).runs()


def test_a_column_that_is_not_in_the_file_is_named(folder):
    change(folder, 'column = "x"', 'column = "xx"')
    with pytest.raises((UnknownName, BadRecording), match="xx"):
        load_case(folder).runs()


def test_the_holdout_file_is_not_opened_until_asked_for(folder):
    (folder / "late.csv").write_text("not a recording")
    with (folder / "case.toml").open("a") as stream:
        stream.write(
            '[[recording]]\nfile = "late.csv"\nrole = "holdout"\ntime = "t"\n'
            '[[recording.channel]]\ncolumn = "x"\nat = "laser"\nkind = "displacement"\nunit = "m"\n'
        )
    case = load_case(folder)
    assert len(case.runs(("fit",))) == 1
    with pytest.raises(VlabError):
        case.runs(("holdout",))


def test_a_part_outside_the_recording_is_refused(folder):
    change(folder, 'time = "t"', 'time = "t"\nstart_s = 100.0')
    with pytest.raises(BadRecording, match=r"runs from 0 to 0\.098 s"):
        load_case(folder).runs()


def test_a_broken_model_is_refused(folder):
    (folder / "rig.xml").write_text(RIG.replace('mass="1"', 'mass="nan"'))
    with pytest.raises(BadStructure, match="finite"):
        load_case(folder)


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "run.csv"
    (folder / "run.csv").rename(outside)
    (folder / "run.csv").symlink_to(outside)
    with pytest.raises(BadCase, match="outside the case's folder"):
        load_case(folder)


def test_a_mistake_in_a_shared_channel_is_placed_where_the_file_has_it(folder):
    text = (folder / "case.toml").read_text()
    shared = '[[channel]]\ncolumn = "y"\nat = "laser"\nkind = "displacement"\nunit = "mmm"\n'
    (folder / "case.toml").write_text(f"{text}\n{shared}")
    with pytest.raises(BadCase, match=r"case\.toml: channel\[0\]: unknown unit 'mmm'; did you mean 'mm'"):
        load_case(folder)


def test_an_error_names_file_and_column_as_the_user_knows_them(tmp_path):
    (tmp_path / "rig.xml").write_text(
        '<mujoco><worldbody><body><joint name="slide" type="slide"/><geom size=".1"/></body></worldbody>'
        '<sensor><jointpos name="encoder" joint="slide"/></sensor></mujoco>'
    )
    (tmp_path / "run1.csv").write_text("t,x\n0,0\n1,1\n")
    text = (
        '[model]\nmjcf = "rig.xml"\n[[recording]]\nfile = "run1.csv"\nrole = "fit"\ntime = "t"\n'
        '[[recording.channel]]\ncolumn = "x"\nat = "encoder"\nkind = "displacement"\nunit = "m"\n'
    )
    for old, new, words in (
        ('unit = "m"', 'unit = "N"', "that of a force, not of a length.*column 'x' of 'run1.csv'"),
        ('at = "encoder"', 'at = "encodr"', "did you mean 'encoder'.*column 'x' of 'run1.csv'"),
        ('time = "t"\n', "", "give rate_hz.*recording 1, 'run1.csv'"),
    ):
        (tmp_path / "case.toml").write_text(text.replace(old, new))
        with pytest.raises(BadCase, match=words):
            load_case(tmp_path)
