"""Next experiment at which two rival models differ most.

Two models with errors of variance s^2 have an expected log likelihood ratio. The ratio is the sum of squares of their
difference over 2 s^2 (Box and Hill 1967). The candidate experiments repeat a recorded excitation at several levels, since
other excitations of the rig are unknown.

References
----------
G. E. P. Box, W. J. Hill, Discrimination among mechanistic models, Technometrics 9 (1967) 57-71.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.inference.evidence import Hypothesis
from vlab.diagnose.problem import Problem
from vlab.diagnose.settings import VALIDATION
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.simulation import ExtendedModel, extended
from vlab.errors import BadCase, Diverged
from vlab.files.text import in_digits
from vlab.parallel import side_by_side
from vlab.signals import Array

POSITIONS = ("angle", "displacement")
"""Kinds of the inputs that are target positions."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Repetition of a recorded excitation.

    Parameters
    ----------
    recording : str
        Name of the recording.
    level : float
        Factor on its inputs [1].
    separation : float
        Rms difference of the rivals over the expected residual [1].
    """

    recording: str
    level: float
    separation: float


def separate(problem: Problem, rivals: Sequence[Hypothesis], runs: Sequence[Run], checked: Sequence[Checked]) -> str:
    """Return the experiment that separates the leading rivals of different physics.

    Parameters
    ----------
    problem : Problem
        Problem.
    rivals : sequence of Hypothesis
        Hypotheses, the leading one first.
    runs : sequence of Run
        Recordings.
    checked : sequence of Checked
        Errors of the reported model on the same recordings.

    Returns
    -------
    str
        Experiment, or "" without rivals.
    """
    leading = [h for h in rivals if h.terms]
    best = {term.effect.physics for term in leading[0].terms} if leading else set()
    other = next((h for h in leading[1:] if {term.effect.physics for term in h.terms} != best), None)
    if other is None:
        return ""
    one, two = (extended(problem, h.long_fit) for h in (leading[0], other))
    return in_words(experiments(one, two, runs, checked), leading[0].label, other.label)


def experiments(
    one: ExtendedModel, other: ExtendedModel, runs: Sequence[Run], checked: Sequence[Checked]
) -> list[Experiment]:
    """Return the candidate experiments for two rivals, the most informative first.

    Recordings without an open-loop input have no level that one could choose.

    Parameters
    ----------
    one, other : ExtendedModel
        Rivals, both fitted.
    runs : sequence of Run
        Recordings.
    checked : sequence of Checked
        Errors of the reported model on the same recordings.

    Returns
    -------
    list of Experiment
        Experiments by separation.
    """
    named = {c.name: c for c in checked}
    plans = [(run, level) for run in runs if _can_be_scaled(run) and run.name in named for level in VALIDATION.levels]
    work = [(model, _at_level(run, level)) for run, level in plans for model in (one, other)]
    simulated = side_by_side(lambda item: _simulated(*item), work)
    found = []
    for (run, level), first, second in zip(plans, simulated[::2], simulated[1::2], strict=True):
        if first is not None and second is not None:
            separation = _separation(first, second, named[run.name], level)
            found.append(Experiment(recording=run.name, level=level, separation=separation))
    return sorted(found, key=lambda e: -e.separation)


def in_words(found: Sequence[Experiment], one: str, other: str) -> str:
    """Return the most informative experiment in words.

    Parameters
    ----------
    found : sequence of Experiment
        Experiments, the most informative first.
    one, other : str
        Names of the rivals.

    Returns
    -------
    str
        Description; "" where no experiment separates the rivals beyond the residual.
    """
    if not found or found[0].separation <= 1.0:
        return ""
    best = found[0]
    recorded = max((e.separation for e in found if e.level == 1.0), default=0.0)
    how = "the excitation" if best.level == 1.0 else f"{best.level:.2g} times the excitation"
    at_recorded = "" if best.level == 1.0 else f", and by at most {in_digits(recorded, 2)} times at the recorded levels"
    return f"{how} of {best.recording}: {one} and {other} differ there by {in_digits(best.separation, 2)} times the residual{at_recorded}"


def _can_be_scaled(run: Run) -> bool:
    """Return whether an open-loop input moves the rig."""
    return run.law is None and any(np.ptp(run.measured[drive.channel]) > 0 for drive in run.drives)


def _at_level(run: Run, level: float) -> Run:
    """Return a run with its inputs at a multiple of their level.

    The level of a target position counts from the first sample, that of a force from zero.
    """
    data = run.measured.data.copy()
    for name in {drive.channel for drive in run.drives}:
        column = run.measured.index(name)
        rest = data[0, column] if run.measured.channels[column].kind in POSITIONS else 0.0
        data[:, column] = rest + level * (data[:, column] - rest)
    return replace(run, measured=replace(run.measured, data=data))


def _simulated(model: ExtendedModel, run: Run) -> Mapping[str, Array] | None:
    try:
        recording = model.simulated(run)
        return {name: recording[name] for name in recording.names}
    except (Diverged, BadCase):
        return None


def _separation(first: Mapping[str, Array], second: Mapping[str, Array], checked: Checked, level: float) -> float:
    """Return the rms difference over channels, each over its expected residual.

    Model error grows with the level, noise does not.
    """
    shares: list[float] = []
    for name, (_, _, after, noise) in checked.channels.items():
        if name not in first or not np.isfinite(after):
            continue
        size = float(np.std(checked.measured[name]))
        expected = size * float(np.hypot(noise, level * np.sqrt(max(after**2 - noise**2, 0.0))))
        difference = first[name] - second[name]
        shares.append(float(np.sqrt(np.mean(np.square(difference)))) / max(expected, 1e-300))
    return float(np.sqrt(np.mean(np.square(shares)))) if shares else 0.0
