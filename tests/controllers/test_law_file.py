"""A law written to a file is the law that is read from it; what is no law is refused in one line."""

import numpy as np
import pytest
from vlab.controllers.law_file import load_law, write_law

from vlab.controllers import DirectRateFeedback, LinearLaw
from vlab.errors import BadController

GAINS = """format = "vlab-law-1"
sensors = ["base", "20in"]
actuators = ["base", "20in"]
gains = [[1.0, 0.5], [0.5, 2.0]]
"""


def test_gains_come_back_to_the_last_bit(tmp_path):
    law = DirectRateFeedback([[0.1, 1 / 3], [1 / 3, 1e-9]], sensors=["a", "b"], actuators=["a", "b"])
    write_law(law, tmp_path / "controller.toml", name="mfdrf", structure="beam", model="full")
    again = load_law(tmp_path / "controller.toml")
    assert isinstance(again, DirectRateFeedback)
    assert again.gains.tobytes() == law.gains.tobytes()
    assert (again.sensors, again.actuators) == (law.sensors, law.actuators)


@pytest.mark.parametrize("states", [0, 3])
def test_a_law_with_states_comes_back_to_the_last_bit(tmp_path, states):
    rng = np.random.default_rng(0)
    matrices = [rng.standard_normal(shape) for shape in ((states, states), (states, 2), (1, states), (1, 2))]
    law = LinearLaw(*matrices, sensors=["a", "b"], actuators=["a"], rate=1000.0)
    write_law(law, tmp_path / "controller.toml")
    again = load_law(tmp_path / "controller.toml")
    assert isinstance(again, LinearLaw)
    assert again.rate == 1000.0
    for read, written in zip(again.matrices, law.matrices, strict=True):
        assert read.tobytes() == written.tobytes()
        assert read.shape == written.shape


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("vlab-law-1", "vlab-law-9"), "format"),
        (("gains = [[1.0, 0.5], [0.5, 2.0]]", "gains = [[1.0, 0.5]]"), "shape"),
        (("gains = [[1.0, 0.5], [0.5, 2.0]]", "gains = [[1.0, 0.5], [0.5]]"), "matrix of numbers"),
        (("gains = [[1.0, 0.5], [0.5, 2.0]]", "gains = [[1.0, nan], [0.5, 2.0]]"), "finite"),
        (("gains = [[1.0, 0.5], [0.5, 2.0]]", 'gains = "big"'), "list was expected"),
        (("gains = [[1.0, 0.5], [0.5, 2.0]]", "A = [[0.0]]"), "either gains or all"),
        (("gains =", "rate_hz = 100.0\ngains ="), "no rate"),
        (("gains =", "gain ="), "did you mean 'gains'"),
        (("sensors = [", "sensors = "), "malformed"),
        (('sensors = ["base", "20in"]\n', ""), "sensors"),
    ],
)
def test_what_is_no_law_is_refused_in_one_line(tmp_path, change, words):
    path = tmp_path / "law.toml"
    path.write_text(GAINS.replace(*change))
    with pytest.raises(BadController, match=words) as refused:
        load_law(path)
    assert str(path) in str(refused.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(BadController, match="there is no such file"):
        load_law(tmp_path / "none.toml")
