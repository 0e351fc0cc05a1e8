"""Manifest of a campaign: code, catalogue, thresholds, versions, commitments."""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import vlab
from vlab import controllers
from vlab.diagnose.settings import SETTINGS
from vlab.files.assets import asset
from vlab.proof.seal import canonical, digest, files_digest
from vlab.proof.targets import targets_to_json

VERSIONS = ("mujoco", "numpy", "scipy", "pyarrow")
SCORING = ("proof/equivalence.py", "proof/judge.py", "proof/score.py", "proof/statistics.py")
"""SCORING: sources of the rules of scoring."""
MORE_SCORING = ("proof/levels.py", "proof/servo_scoring.py", "proof/stated.py", "proof/targets.py")
"""MORE_SCORING: sources of the rules that came after the stored answers were frozen."""
NOT_ANSWERING = (
    "views/",
    "cli/",
    "reproduce/",
    "demo",
    "bench",
    "proof/real/",
    "proof/peers/scoring.py",
    *SCORING,
    *MORE_SCORING,
)
"""NOT_ANSWERING: sources without influence on answers."""
ASSETS = ("beam.toml", "grid.toml", "laboratory.toml")


def manifest(commitments: Any, **settings: Any) -> dict[str, Any]:
    """Return the manifest of answers to some commitments.

    Parameters
    ----------
    commitments : object
        Commitments of the cases.
    **settings
        Further settings of the answers.

    Returns
    -------
    dict
        Plain values.
    """
    root = Path(vlab.__file__).parent
    thresholds = {room: asdict(settings) for room, settings in SETTINGS.items()}
    bound = {
        "written_by": "vlab",
        "vlab": vlab.__version__,
        "python": sys.version.split()[0],
        "versions": {name: metadata.version(name) for name in VERSIONS},
        "code": _sources(root, "**/*.py"),
        "laws": files_digest((p.name, p) for folder in controllers.__path__ for p in Path(folder).glob("*.py")),
        "catalogue": _sources(root / "physics", "**/*.py"),
        "structures": _structures(),
        "scoring": scoring_digest(),
        "more_scoring": scoring_digest(MORE_SCORING),
        "targets": targets_to_json(),
        "thresholds": thresholds,
        "thresholds_sha256": digest(thresholds),
        "commitments": digest(commitments),
        **settings,
    }
    return dict(json.loads(canonical(bound)))  # in the form of a later reading


def scoring_digest(sources: Sequence[str] = SCORING) -> str:
    """Return the SHA-256 of sources of the rules of scoring.

    Parameters
    ----------
    sources : sequence of str
        `SCORING` or `MORE_SCORING`.

    Returns
    -------
    str
        Hexadecimal digest.
    """
    root = Path(vlab.__file__).parent
    return files_digest((Path(name).name, root / name) for name in sources)


def is_set_down(answered_with: Mapping[str, Any]) -> bool:
    """Return whether the rules of scoring are those of a manifest.

    Parameters
    ----------
    answered_with : mapping
        Manifest; the stored ones are older than `MORE_SCORING`.

    Returns
    -------
    bool
        Whether all rules that the manifest binds are the present ones.
    """
    more = scoring_digest(MORE_SCORING)
    return answered_with.get("scoring") == scoring_digest() and answered_with.get("more_scoring", more) == more


def generator_digest() -> str:
    """Return the SHA-256 of sources and libraries of the generator."""
    root = Path(vlab.__file__).parent
    made = [_sources(root / "proof", pattern) for pattern in ("generator/*.py", "suites.py", "writing.py")]
    made += [_sources(root / room, "*.py") for room in ("fe", "structure")]
    return digest([*made, _structures(), *(metadata.version(name) for name in (*VERSIONS[1:], "numba"))])


def _structures() -> str:
    return files_digest((name, asset(name)) for name in ASSETS)


def _sources(root: Path, pattern: str) -> str:
    """Return the SHA-256 of source files that influence answers."""
    files = ((p.relative_to(root).as_posix(), p) for p in root.glob(pattern) if "__pycache__" not in p.parts)
    elsewhere = (*NOT_ANSWERING, "controllers/")  # the laws, inside the package in a wheel, have a digest of their own
    return files_digest((name, path) for name, path in files if not name.startswith(elsewhere))
