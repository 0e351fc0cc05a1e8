"""What a case says of its files, beside the model as given: every slip is named with the line that mends it, and nothing else is."""

import numpy as np
import pytest
from file_rigs import (
    MASS_CHANNELS,
    Thing,
    changed,
    integrate,
    masses_case,
    noise_input,
    pendulum,
    recorded_masses,
    recorded_servo,
    servo_case,
)

from vlab import units
from vlab.cases.case import load_case
from vlab.cases.checks import check_recordings
from vlab.cases.checks.bands import bands
from vlab.cases.compare import compare_case
from vlab.errors import BadCase, BadUnit


@pytest.fixture(scope="module")
def masses():
    return recorded_masses()


@pytest.fixture(scope="module")
def servo():
    return recorded_servo()


def found(case):
    """Return severities and texts of what is wrong with a case."""
    return [(f.severity, f.text) for f in check_recordings(case).found]


def times_of(text):
    """Return the factor that a text says."""
    return float(text.split(" is ")[1].split(" times")[0])


# ---- signs and units -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "factor", "line"),
    [
        ("two", 1000.0, 'unit = "mm" in every [[recording.channel]] with column = "two"'),
        ("one", 1 / 0.0254, 'unit = "in" in every [[recording.channel]] with column = "one"'),
        ("one", 1 / 0.3048, 'unit = "ft" in every [[recording.channel]] with column = "one"'),
        ("one", -1000.0, 'scale = -0.001 in every [[recording.channel]] with column = "one"'),
    ],
)
def test_an_output_in_another_unit_is_named_with_its_line(tmp_path, masses, column, factor, line):
    ((severity, text),) = found(masses_case(tmp_path, changed(masses, lambda run: {column: factor * run[column]})))
    assert severity == "fatal"
    assert line in text
    assert times_of(text) == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize(("unit", "newtons"), [("lbf", 4.4482216), ("kN", 1e3), ("kgf", 9.80665)])
def test_an_input_in_another_unit_is_named_where_all_outputs_ask_for_it(tmp_path, masses, unit, newtons):
    ((severity, text),) = found(masses_case(tmp_path, changed(masses, lambda run: {"force": run["force"] / newtons})))
    assert severity == "fatal"
    assert f'unit = "{unit}" in every [[recording.channel]] with column = "force"' in text


def test_of_one_input_and_one_output_both_lines_are_offered(tmp_path, masses):
    channels = {name: MASS_CHANNELS[name] for name in ("force", "one")}
    only = changed(masses, lambda run: {"one": 1000.0 * run["one"]})
    ((_, text),) = found(masses_case(tmp_path, only, channels=channels))
    assert 'unit = "mm" in every [[recording.channel]] with column = "one"' in text
    assert 'unit = "kN" in every [[recording.channel]] with column = "force"' in text


def test_the_line_that_is_offered_mends_the_case(tmp_path, masses):
    wrong = changed(masses, lambda run: {"two": 1000.0 * run["two"]})
    assert found(masses_case(tmp_path / "wrong", wrong))
    assert found(masses_case(tmp_path / "mended", wrong, said={"two": {"unit": "mm"}})) == []


@pytest.mark.parametrize("column", ["one", "two"])
def test_a_turned_output_is_a_warning_for_its_polarity_may_be_physics(tmp_path, masses, column):
    ((severity, text),) = found(masses_case(tmp_path, changed(masses, lambda run: {column: -run[column]})))
    assert severity == "warning"
    assert f'scale = -1 in every [[recording.channel]] with column = "{column}"' in text
    assert "fit -1.00" in text


def test_a_turned_input_is_named_where_all_outputs_are_turned(tmp_path, masses):
    ((severity, text),) = found(masses_case(tmp_path, changed(masses, lambda run: {"force": -run["force"]})))
    assert severity == "warning"
    assert 'scale = -1 in every [[recording.channel]] with column = "force"' in text


def test_a_turned_encoder_of_a_servo_that_starts_elsewhere_is_named(tmp_path, servo):
    ((severity, text),) = found(servo_case(tmp_path, changed(servo, lambda run: {"angle": -run["angle"]})))
    assert severity == "warning"
    assert 'scale = -1 in every [[recording.channel]] with column = "angle"' in text


@pytest.mark.parametrize("column", ["command", "angle"])
def test_degrees_of_a_servo_are_named_though_the_model_is_far_from_linear_then(tmp_path, servo, column):
    wrong = changed(servo, lambda run: {column: np.degrees(run[column])})
    ((severity, text),) = found(servo_case(tmp_path, wrong))
    assert severity == "fatal"
    assert f'unit = "deg" in every [[recording.channel]] with column = "{column}"' in text


def test_a_slip_is_named_although_physics_is_missing_as_well(tmp_path):
    rubbing = recorded_masses(Thing(friction=0.8))
    ((severity, text),) = found(masses_case(tmp_path, changed(rubbing, lambda run: {"one": 1000.0 * run["one"]})))
    assert severity == "fatal"
    assert 'unit = "mm"' in text


# ---- columns and time ------------------------------------------------------------------------------------------------


def test_exchanged_outputs_are_named(tmp_path, masses):
    wrong = changed(masses, lambda run: {"one": run["two"], "two": run["one"]})
    ((severity, text),) = found(masses_case(tmp_path, wrong))
    assert severity == "fatal"
    assert 'at = "x1" in [[recording.channel]] with column = "two"' in text
    assert 'at = "d2" in [[recording.channel]] with column = "one"' in text


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "how"), [(6, "30 ms late"), (-6, "30 ms early")])
def test_an_output_that_is_late_or_early_is_noted(tmp_path, masses, samples, how):
    wrong = changed(masses, lambda run: {"two": np.roll(run["two"], samples)})
    ((severity, text),) = found(masses_case(tmp_path, wrong))
    assert severity == "note"
    assert f"d2 is {how}" in text


@pytest.mark.slow
def test_one_late_output_alone_may_be_due_to_its_input(tmp_path, masses):
    late = changed(masses, lambda run: {"two": np.roll(run["two"], 6)})
    alone = {name: {key: column for key, column in run.items() if key != "one"} for name, run in late.items()}
    ((_, text),) = found(masses_case(tmp_path, alone))
    assert "d2 is 30 ms late" in text
    assert "its sensor is late, or motor acts late, which one channel cannot tell" in text


@pytest.mark.slow
def test_the_effect_that_is_offered_for_a_late_output_mends_the_case(tmp_path, masses):
    wrong = changed(masses, lambda run: {"two": np.roll(run["two"], 6)})
    ((_, text),) = found(masses_case(tmp_path, wrong))
    seconds = text.split("delay = ")[1].split(" ")[0]
    path = tmp_path / "case.toml"
    path.write_text(
        path.read_text(encoding="utf-8")
        + f'[[model.effect]]\nname = "sensor-delay"\nplace = "d2"\nparameters = {{ delay = {seconds} }}\n',
        encoding="utf-8",
    )
    assert found(load_case(path)) == []


def test_inputs_of_other_recordings_are_no_inputs_of_these(tmp_path, masses):
    names = list(masses)
    wrong = {name: {**masses[name], "force": masses[names[k - 1]]["force"]} for k, name in enumerate(names)}
    ((severity, text),) = found(masses_case(tmp_path, wrong))
    assert severity == "warning"
    assert "no recorded output moves with motor" in text


@pytest.mark.parametrize("left_out", ["one", "two"])
def test_a_recording_may_lack_a_channel_that_nothing_explains(tmp_path, masses, left_out):
    names = list(masses)
    wrong = {name: {**masses[name], "force": masses[names[k - 1]]["force"]} for k, name in enumerate(names)}
    del wrong[names[1]][left_out]
    ((severity, text),) = found(masses_case(tmp_path, wrong))
    assert severity == "warning"
    assert "no recorded output moves with motor" in text


@pytest.mark.parametrize(
    ("clock", "name", "line"),
    [
        ('time = "t_ms"', "t_ms", 'say time_unit = "ms"'),
        ('time = "t"', "t", 'say time_unit = "ms"'),
        ("rate_hz = 0.2", "t", "rate_hz = 200"),
    ],
)
def test_time_in_milliseconds_is_refused_before_it_is_simulated(tmp_path, masses, clock, name, line):
    case = masses_case(tmp_path, masses, clock=clock, time=name, times=1e3)
    with pytest.raises(BadCase, match=line):
        compare_case(case.path)


def test_time_in_milliseconds_that_is_said_is_read(tmp_path, masses):
    clock = 'time = "t_ms"\ntime_unit = "ms"'
    assert found(masses_case(tmp_path, masses, clock=clock, time="t_ms", times=1e3)) == []


def test_slow_samples_of_slow_motion_are_no_milliseconds(tmp_path):
    rng = np.random.default_rng(5)
    runs = {}
    for name in ("run1", "run2"):
        u = np.repeat(noise_input(rng, 0.6, 0.0, 20.0), 40)  # a step every 0.2 s, sampled as often
        q = integrate(Thing().accelerations, u, 2)[::40]
        runs[name] = {"force": u[::40], "one": q[:, 0], "two": q[:, 1]}
    assert found(masses_case(tmp_path, runs, times=40.0)) == []


# ---- what is right, and what is physics, is not named -----------------------------------------------------------------


@pytest.mark.parametrize(
    "thing",
    [
        Thing(),
        Thing(softer=0.7),
        Thing(softer=0.94, damping=0.1),
        Thing(softer=0.2),
        Thing(payload=0.2),
        Thing(friction=0.8),
        Thing(gain=0.5),
        Thing(gain=1.5),
        Thing(gain=3.0),
    ],
    ids=str,
)
def test_missing_physics_is_no_slip(tmp_path, thing):
    assert found(masses_case(tmp_path, recorded_masses(thing))) == []


@pytest.mark.slow
def test_much_noise_is_no_slip(tmp_path):
    assert found(masses_case(tmp_path, recorded_masses(noise=0.5))) == []


@pytest.mark.parametrize("gain", [1.0, 0.6])
def test_a_soft_servo_is_no_slip(tmp_path, gain):
    assert found(servo_case(tmp_path, recorded_servo(gain))) == []


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_a_sensor_whose_calibration_is_off_is_no_slip(tmp_path, masses, factor):
    assert found(masses_case(tmp_path, changed(masses, lambda run: {"two": factor * run["two"]}))) == []


def test_free_swings_from_another_place_are_no_slip(tmp_path):
    runs = {}
    for k, start in enumerate((0.3, 0.8, 1.2)):
        still = np.zeros(800)
        runs[f"run{k + 1}"] = {"command": still, "angle": integrate(pendulum, still, 1, np.array([start]))[:, 0]}
    assert found(servo_case(tmp_path, runs)) == []


# ---- which units may be confused -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "si", "other", "factor"),
    [
        ("m", "m", "mm", 1e-3),
        ("mm", "m", "in", 25.4),
        ("in", "m", "cm", 1 / 2.54),
        ("m", "m", "ft", 0.3048),
        ("rad", "rad", "deg", np.pi / 180),
        ("rad", "rad", "rev", 2 * np.pi),
        ("rad/s", "rad/s", "rpm", 2 * np.pi / 60),
        ("m/s^2", "m/s^2", "g", 9.80665),
        ("N", "N", "lbf", 4.4482216152605),
        ("m/s^2/N", "m/s^2/N", "g/N", 9.80665),
    ],
)
def test_units_of_a_kind_are_those_that_laboratories_write(unit, si, other, factor):
    assert units.mistaken(unit, si)[other] == pytest.approx(factor, rel=1e-9)
    assert unit not in units.mistaken(unit, si)


def test_numbers_of_a_free_kind_have_no_unit_to_mistake():
    assert units.mistaken("counts", "") == {}
    with pytest.raises(BadUnit):
        units.mistaken("N", "m")


# ---- what compare says ----------------------------------------------------------------------------------------------


def test_a_comparison_says_sizes_and_correlations_and_what_is_wrong(tmp_path, masses):
    case = masses_case(tmp_path, changed(masses, lambda run: {"two": -1000.0 * run["two"]}))
    compared = compare_case(case.path)
    (two,) = (m for m in compared.runs[0].misfits if m.channel == "d2")
    assert two.rms_ratio == pytest.approx(1000.0, rel=0.02)
    assert two.correlation == pytest.approx(-1.0, abs=0.02)
    assert any("-1000 times" in line or "scale = -0.001" in line for line in compared.remarks)
    assert compared.to_json()["remarks"] == list(compared.remarks)


@pytest.mark.slow
def test_a_comparison_says_which_channels_stand_still(tmp_path, masses):
    compared = compare_case(
        masses_case(tmp_path, changed(masses, lambda run: {"two": np.full(len(run["two"]), 1e-3)})).path
    )
    assert [m.channel for m in compared.runs[0].misfits] == ["x1"]
    assert "run1: d2 is 0.001 m throughout" in compared.remarks[0]


# ---- copies ----------------------------------------------------------------------------------------------------------


def test_a_held_out_copy_of_a_fitted_recording_verifies_nothing(tmp_path, masses):
    case = masses_case(tmp_path, dict.fromkeys(masses, masses["run1"]))
    fatal = check_recordings(case).of("fatal")
    assert len(fatal) == 1
    assert "run3: all readings equal those of run1, which is fitted" in fatal[0]
    assert not check_recordings(masses_case(tmp_path / "other", masses)).of("fatal")


@pytest.mark.parametrize("n", [2, 3, 9])
def test_a_record_of_a_few_samples_has_no_bands(n):
    t = 0.01 * np.arange(n)
    assert len(bands(t, t, t)) == 0
