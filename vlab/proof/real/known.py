"""Answer keys of real cases: origin, licence, accepted answers, sources.

A file of keys holds ``[[case]]`` tables. vlab's own is ``assets/real.toml``; a folder of a case may hold ``known.toml``
of the same form, which counts first.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vlab.errors import BadProof, unknown_name
from vlab.files.assets import asset
from vlab.files.toml import Reader
from vlab.physics.catalogue import EFFECTS
from vlab.proof.real.folders import KNOWN, RealCase

FILE = "real.toml"
"""FILE: keys of the cases that vlab was tried on."""


@dataclass(frozen=True, kw_only=True)
class KnownEffect:
    """Physics that a case is known to have beyond its model.

    Parameters
    ----------
    effects : tuple of str
        Accepted names; none if only the family is known.
    families : tuple of str
        Accepted families.
    places : tuple of str
        Accepted places; none if unknown.
    """

    effects: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    places: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.effects and not self.families:
            raise BadProof("an effect needs effects, families or both")
        families = sorted({e.family for e in EFFECTS.values()})
        for kind, given, accepted in (("effect", self.effects, EFFECTS), ("family", self.families, families)):
            for name in given:
                if name not in accepted:
                    raise BadProof(str(unknown_name(kind, name, accepted)))


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Benchmark whose community prints the error of one channel.

    Parameters
    ----------
    name : str
        Benchmark.
    channel : str
        Channel.
    unit : str
        Printed unit.
    factor : float
        Printed unit per SI unit of the channel.
    skip : int
        First samples that the error leaves out.
    remark : str
        How the recordings of the case differ from those of the benchmark.
    source : str
        Source of the convention.
    """

    name: str
    channel: str
    unit: str
    factor: float
    skip: int
    remark: str
    source: str

    def __post_init__(self) -> None:
        if self.skip < 0:
            raise BadProof(f"skip is {self.skip}; accepted: 0 or more samples")
        if not self.factor > 0.0:
            raise BadProof(f"factor is {self.factor:g}; it must be positive")


@dataclass(frozen=True, kw_only=True)
class KnownCase:
    """Answer key of a case.

    Parameters
    ----------
    name : str
        Name of the case, see `vlab.proof.real.folders.RealCase`.
    origin, licence : str
        Origin of the recordings and their licence.
    known : str
        What is known, in a sentence.
    source : str
        Source of what is known.
    effect : tuple of KnownEffect
        Physics that the model lacks; none where the cause is undocumented.
    abstention : bool
        Whether an answer without findings is right.
    benchmark : tuple of Benchmark
        Benchmark of the recordings, at most one.
    """

    name: str
    origin: str
    licence: str
    known: str
    source: str
    effect: tuple[KnownEffect, ...] = ()
    abstention: bool = False
    benchmark: tuple[Benchmark, ...] = ()

    def __post_init__(self) -> None:
        for key in ("name", "origin", "licence", "known", "source"):
            if not getattr(self, key).strip():
                raise BadProof(f"{key} is empty; state it")
        if len(self.benchmark) > 1:
            raise BadProof("a case has one benchmark at most")

    @property
    def is_documented(self) -> bool:
        """Whether an answer can be right or wrong."""
        return bool(self.effect) or self.abstention

    @property
    def skip(self) -> int:
        """First samples that absolute errors leave out."""
        return self.benchmark[0].skip if self.benchmark else 0


@dataclass(frozen=True, kw_only=True)
class KnownFile:
    """Contents of a file of keys."""

    case: tuple[KnownCase, ...]


def read_known(path: Path) -> dict[str, KnownCase]:
    """Read a file of answer keys.

    Parameters
    ----------
    path : Path
        TOML file.

    Returns
    -------
    dict
        Key by name of the case.

    Raises
    ------
    BadProof
        The file is malformed, a key is missing or unknown, or a name occurs twice.
    """
    reader = Reader(path, provenance_required=False, error=BadProof)
    found = reader.table(KnownFile, reader.load()).case
    names = [case.name for case in found]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise reader.fail(f"case[{i}]", f"the name {name!r} stands twice; keep one key")
    return dict(zip(names, found, strict=True))


def known_of(cases: Sequence[RealCase], path: Path | None = None) -> dict[str, KnownCase]:
    """Return the answer keys of some cases.

    Parameters
    ----------
    cases : sequence of RealCase
        Cases.
    path : Path, optional
        File of keys; vlab's own by default.

    Returns
    -------
    dict
        Key by name of the case. Cases without a key are absent.

    Raises
    ------
    BadProof
        A file of keys is malformed.
    """
    common = read_known(asset(FILE) if path is None else path)
    out = {}
    for case in cases:
        beside = case.folder / KNOWN
        own = {**common, **(read_known(beside) if beside.is_file() else {})}
        if case.name in own:
            out[case.name] = own[case.name]
    return out
