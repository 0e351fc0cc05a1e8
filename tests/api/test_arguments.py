"""Arguments of the Python interface: another type is one line of vlab's own, with what is accepted."""

import numpy as np
import pandas as pd
import pytest
from carriage import MODEL, run

import vlab
from vlab.errors import VlabError
from vlab.files.arguments import in_python
from vlab.files.assets import asset
from vlab.files.text import with_article

T, FORCE, POSITION = run(1)
HAMMER = {"inputs": ["Hammer=force,N"], "outputs": ["Vel40in=velocity,mm/s", "VelBase=velocity,mm/s"]}


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: vlab.experiment(3), r"vlab.experiment: structure is 3 \(an int\); accepted: text"),
        (lambda: vlab.experiment("beam", seconds="5"), "seconds is the text '5'; accepted: a number or None"),
        (lambda: vlab.experiment("beam", seed=True), r"seed is True \(a bool\); accepted: a whole number"),
        (lambda: vlab.design("beam", "lqr", r="1"), "vlab.design: r is the text '1'"),
        (lambda: vlab.diagnose(np.zeros(9)), r"case is an ndarray of shape \(9,\).*vlab.Case.from_arrays"),
        (lambda: vlab.diagnose(None), "case is None"),
        (lambda: vlab.diagnose("case.toml", jobs="2"), "jobs is the text '2'; accepted: a whole number or None"),
        (lambda: vlab.modal_test(None), "vlab.modal_test: runs is None; accepted: .*a sequence of such; .*DataFrame"),
        (lambda: vlab.modal_test(np.zeros((9, 2))), r"runs is an ndarray of shape \(9, 2\)"),
        (lambda: vlab.modal_test([None]), "runs holds None"),
        (lambda: vlab.modal_test("none.csv", band_hz=3), r"accepted: \(a number, a number\) or None"),
        (lambda: vlab.modal_test(pd.DataFrame({"a": T})), "name them with inputs= and outputs="),
    ],
)
def test_another_type_is_refused_with_what_is_accepted(call, match):
    with pytest.raises(VlabError, match=match) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_pythons_own_message_names_an_unknown_argument():
    with pytest.raises(TypeError, match="unexpected keyword argument 'duration'"):
        vlab.experiment("beam", duration=5)


def test_numbers_of_numpy_and_a_single_text_are_taken():
    done = vlab.experiment("beam", seconds=np.float32(0.25), seed=np.int64(3), progress=False)
    assert (done.prepared.settings.seconds, done.prepared.settings.seed) == (0.25, 3)
    one = vlab.experiment("beam", seconds=0.1, effects="viscous-damping@base:damping=1", progress=False)
    assert one.prepared.settings.effect == ("viscous-damping@base:damping=1",)


def test_a_data_frame_is_tested_as_its_file():
    file = asset("examples/hammer.csv")
    frame = pd.read_csv(file, comment="#")
    by_file, by_frame = vlab.modal_test(file, **HAMMER), vlab.modal_test(frame, **HAMMER)
    np.testing.assert_allclose(by_frame.poles.freq, by_file.poles.freq, rtol=1e-9)
    time = next(name for name in frame.columns if name.lower().startswith(("t", "time")))
    indexed = frame.set_index(time)
    indexed.index.name = "time"
    np.testing.assert_allclose(vlab.modal_test(indexed, **HAMMER).poles.freq, by_file.poles.freq, rtol=1e-9)


def test_gaps_matter_in_the_named_columns_alone(tmp_path):
    frame = pd.read_csv(asset("examples/hammer.csv"), comment="#")
    frame["room"] = np.nan
    frame.to_csv(tmp_path / "gaps.csv", index=False)
    whole = vlab.modal_test(asset("examples/hammer.csv"), **HAMMER)
    np.testing.assert_allclose(vlab.modal_test(tmp_path / "gaps.csv", **HAMMER).poles.freq, whole.poles.freq, rtol=1e-9)
    frame.loc[5, "Hammer"] = np.nan
    frame.to_csv(tmp_path / "gaps.csv", index=False)
    with pytest.raises(VlabError, match="Hammer"):
        vlab.modal_test(tmp_path / "gaps.csv", **HAMMER)


def test_a_case_in_memory_speaks_of_arguments():
    def case(outputs=None, **changes):
        return vlab.Case.from_arrays(MODEL, T, {"motor": FORCE}, outputs or {"encoder": POSITION}, **changes)

    (channel,) = [c for c in case(channels={"encoder": "mm"}).table.recording[0].channel if not c.input]
    assert channel.unit == "mm"
    for call, match in (
        (lambda: case(channels={"encoder": 3}), r"channels\['encoder'\] is an int; accepted: a unit"),
        (lambda: case(channels={"encoder": {"unt": "mm"}}), r"channels\['encoder'\]: unknown key 'unt'"),
        (lambda: case(channels="mm"), "vlab.Case.from_arrays: channels is the text 'mm'; accepted: a dict or None"),
        (lambda: case(initial="zero"), "case in memory: initial: unknown value 'zero'"),
        (lambda: case({"encoder": POSITION * 1j}), "'encoder' of run1 is complex; give real samples"),
        (lambda: vlab.Case.from_arrays(MODEL, T[::-1], {}, {"encoder": POSITION}), r"give even times instead"),
        (lambda: case(holdout=[0]), "the only run is held out"),
        (lambda: vlab.Case.from_arrays(3, T, {}, {"encoder": POSITION}), "the model is an int"),
    ):
        with pytest.raises(VlabError, match=match) as refused:
            call()
        assert "recording[" not in str(refused.value)
        assert "rate_hz" not in str(refused.value)


def test_one_data_frame_holds_inputs_and_outputs():
    frame = pd.DataFrame({"time": T, "motor": FORCE, "encoder": POSITION})
    one = vlab.Case.from_arrays(MODEL, "time", frame, frame)
    two = vlab.Case.from_arrays(MODEL, T, {"motor": FORCE}, {"encoder": POSITION})
    assert [c.column for c in one.table.recording[0].channel] == [c.column for c in two.table.recording[0].channel]
    with pytest.raises(VlabError, match="unknown sensor 'room'"):
        vlab.Case.from_arrays(MODEL, "time", frame.assign(room=1.0), frame.assign(room=1.0))


def test_options_become_arguments():
    options = {"--rate": "rate_hz", "--output": "outputs", "--signal": "signal"}
    assert in_python("run at --rate 200, or --other 3", options) == "run at rate_hz=200, or --other 3"
    assert in_python("such as --output a=acceleration,g", options) == 'such as outputs=["a=acceleration,g"]'
    assert in_python("give --signal dwell where it is one", options) == 'give signal="dwell" where it is one'


@pytest.mark.parametrize(
    ("word", "phrase"), [("int", "an int"), ("ndarray", "an ndarray"), ("str", "a str"), ("NoneType", "None")]
)
def test_types_have_their_article(word, phrase):
    assert with_article(word) == phrase
