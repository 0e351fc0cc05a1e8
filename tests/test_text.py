"""Text from data: nothing in it drives a terminal, forges a line or breaks the encoding."""

import pytest

from vlab.files.text import as_sentence, in_digits, in_line, one_line, printable

HOSTILE = {
    "colour": "\x1b[31mred\x1b[0m",
    "title of the window": "\x1b]0;owned\x07",
    "bell and backspace": "a\x07\x08b",
    "control sequence of one byte": "\x9b31m",
    "direction turned": "abc\u202egnp.exe\u2066x\u2069",
    "without width": "a\u200bb\ufeffc",
    "half a pair": "a\udc80b",
    "end of line of another kind": "a\u2028b\x85c",
    "carriage return": "all is well\rerror",
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("shown", [printable, in_line, one_line])
def test_what_is_shown_is_printable_and_can_be_encoded(shown, text):
    line = shown(text)
    assert line.isprintable()
    line.encode()


def test_plain_text_stays_as_it_is():
    text = "café, ½ ω² ≤ 3 µm/s\n\ttable  of  two"
    assert printable(text) == text
    assert in_line("a\nerror: b") == "a\\x0aerror: b"
    assert one_line(" a\n\tb\u00a0c ") == "a b c"
    assert one_line("x" * 500) == "x" * 400 + "..."
    assert printable("\x1b\u202e\U000e0001") == "\\x1b\\u202e\\U000e0001"


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(273.4, 2, "270"), (7941.0, 3, "7940"), (0.00123, 2, "0.0012"), (11.71, 3, "11.7"), (2.5e6, 2, "2.5e+06")],
)
def test_a_sentence_has_numbers_without_exponents(value, digits, text):
    assert in_digits(value, digits) == text


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("noise of joint:base: 0.4 %", "Noise of joint:base: 0.4 %."),
        ("gain:elbow was calibrated", "gain:elbow was calibrated."),
        (
            "smooth-friction@joint:elbow has as small a residual.",
            "smooth-friction@joint:elbow has as small a residual.",
        ),
        ("case.toml names run_3", "case.toml names run_3."),
        ("log1: no motion", "log1: no motion."),
        ("measured, not simulated: MPU 6050", "Measured, not simulated: MPU 6050."),
        ("", "."),
    ],
)
def test_a_sentence_starts_with_a_capital_or_a_name(text, sentence):
    assert as_sentence(text) == sentence
