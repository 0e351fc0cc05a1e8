"""Code of laws without vlab: what comes along, and what is refused."""

import json

import numpy as np
import pytest

from vlab.physics.effect import Parameter, PortEffect
from vlab.physics.port_nonlinear import DeadBand
from vlab.standalone.law_module import _quoted
from vlab.standalone.law_source import CannotWrite, LawCode

GAIN = np.array([1.0, 2.0])


def halved(x):
    return 0.5 * x


class Own(PortEffect):
    """A user's law.

    With a second paragraph.
    """

    name = "own"
    family = "friction"
    law = "F = -k z"
    words = "a law of a user"
    parameters = (Parameter(name="k", unit="N/m", low=1.0, high=2.0),)
    shift = 0.25

    def force(self, z, v, p, step, memory):
        return -p["k"] * halved(z - self.shift) * GAIN[1], memory


class Serial(Own):
    """A law that reads text."""

    def force(self, z, v, p, step, memory):
        return json.loads("1.0") * z, memory


class Inherited(Own):
    """A law that calls its base class."""

    def force(self, z, v, p, step, memory):
        return super().force(z, v, p, step, memory)


def test_a_users_law_comes_with_all_that_it_names():
    code, names = LawCode(), {"np": np}
    assert code.add(Own()) == "Own()"
    exec(compile(code.text, "law", "exec"), names)
    assert names["Own"]().force(1.25, 0.0, {"k": 3.0}, None, None) == (-3.0, None)
    assert names["Own"].__doc__.startswith("A user's law.")


def test_a_law_is_written_once():
    code = LawCode()
    code.add(DeadBand())
    before = code.text
    code.add(DeadBand())
    assert code.text == before


@pytest.mark.parametrize(("law", "reason"), [(Serial, "json"), (Inherited, "base class")])
def test_code_that_needs_more_is_refused_and_leaves_nothing(law, reason):
    code = LawCode()
    with pytest.raises(CannotWrite, match=reason):
        code.add(law())
    assert code.text == ""
    assert not code.imports


def test_a_name_of_the_model_cannot_leave_the_docstring():
    text = f'"""{_quoted(chr(34) * 3 + chr(10) + "import os" + chr(92))}"""'
    assert text.count('"') == 6
    assert "\n" not in text
    assert "\\" not in text
