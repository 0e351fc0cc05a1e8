"""Files with a few bytes, words or lines changed, and a bound on the work that each may make."""

import re
import signal

SIGNS = (b"\n", b",", b";", b'"', b"#", b"-", b"e", b"j", b"nan", b"inf", b"1_0", b"\0", b"\r")
SIZES = (b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0" * 4, b"\0\0\0\x40", b"\xff" * 8)
EDITS = ("flip", "insert", "overwrite", "delete", "cut")
WORDS = (
    "nan", "-inf", "1e999", "1e308", "-1e30", "1e30", "1e10", "1e-30", "1e-300", "0", "-1", "0.5", "7", "9999", "9223372036854775807",
    "true", "null", "''", '"x"', "[]", "{}", "[[1e30]]", '"\\u001b[2J"', '"../../etc"', "1979-05-27", "x" * 300,
)  # fmt: skip
"""What takes the place of a number or a word: no numbers, huge and tiny ones, other types, text that leaves its place."""
_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
_WORD = re.compile(rb"[A-Za-z_][\w:.-]*")


def mutate(data, edits):
    """Return bytes with edits (what, where, content)."""
    data = bytearray(data)
    for what, where, content in edits:
        at = where % max(len(data), 1)
        if what == "flip" and data:
            data[at] ^= content[0] or 1
        elif what == "insert":
            data[at:at] = content
        elif what == "overwrite":
            data[at : at + len(content)] = content
        elif what == "delete":
            del data[at : at + len(content)]
        elif what == "cut" and where % 4 == 0:
            del data[at:]
    return bytes(data)


def mutated_text(data, rng):
    """Return a text with one to three of its numbers, words or lines changed."""
    for _ in range(rng.integers(1, 4)):
        how = rng.choice(["number", "number", "word", "swap", "line", "twice"])
        if how in ("number", "word", "swap"):
            spots = list((_NUMBER if how == "number" else _WORD).finditer(data))
            if not spots:
                continue
            spot = spots[rng.integers(len(spots))]
            put = spots[rng.integers(len(spots))][0] if how == "swap" else str(rng.choice(WORDS)).encode()
            data = data[: spot.start()] + put + data[spot.end() :]
        else:
            lines = data.split(b"\n")
            at = int(rng.integers(len(lines)))
            lines[at : at + 1] = [] if how == "line" else [lines[at]] * 2
            data = b"\n".join(lines)
    return data


def mutated_bytes(data, rng):
    """Return bytes with one to four edits."""
    content = (*SIGNS, *SIZES, *(bytes(rng.integers(0, 256, rng.integers(1, 9), dtype="u1")) for _ in range(18)))
    edits = [
        (str(rng.choice(EDITS)), int(rng.integers(2**20)), content[rng.integers(len(content))])
        for _ in range(rng.integers(1, 5))
    ]
    return mutate(data, edits)


class TooMuchWork(BaseException):
    """A file made more work than its size allows for; no handler of errors may take it for one of its own."""


class Bound:
    """Ends a block that computes for longer than so many seconds; time in which other processes have the machine does not count."""

    def __init__(self, seconds):
        self.seconds = seconds

    def __enter__(self):
        def stop(number, frame):
            raise TooMuchWork(f"more than {self.seconds} s of work")

        self.before = signal.signal(signal.SIGVTALRM, stop)
        signal.setitimer(signal.ITIMER_VIRTUAL, self.seconds)

    def __exit__(self, *exception):
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, self.before)
