"""Evaluation of a finished law on a model."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.controllers.catalogue import Asked
from vlab.controllers.law_file import is_law_file
from vlab.controllers.linear import LinearController
from vlab.controllers.user_law import code_of, is_user_law
from vlab.design import performance
from vlab.design.state_model import state_model
from vlab.design.weights import weights_of
from vlab.errors import BadController
from vlab.fe.model import FeModel
from vlab.hardware import Hardware, load_hardware
from vlab.lab.laws import named_law
from vlab.lab.prediction import SampledLoop, loop_on


def is_given(name: str) -> bool:
    """Return whether a name means a finished law, not one to design."""
    return is_user_law(name) or is_law_file(name)


def file_of(name: str) -> str:
    """Return the file in the name of a law.

    A name without a file is returned unchanged.
    """
    return code_of(name) or name


@dataclass(frozen=True, kw_only=True, eq=False)
class LawArgument:
    """Law in the laboratory's sampled loop.

    Parameters
    ----------
    law : LinearController
        Control law.
    loop : SampledLoop
        Sampled loop.
    """

    law: LinearController
    loop: SampledLoop
    fe: FeModel

    def describe(self, modes: tuple[int, ...], asked: Asked) -> dict[str, Any]:
        """Return matrices, damping ratios and continuous indices.

        A law with states has no continuous indices.

        Parameters
        ----------
        modes : tuple of int
            Reported modes, from 1.
        asked : Asked
            Settings of the design.

        Returns
        -------
        dict
            Plain data for JSON.
        """
        if len(self.law.matrices[0]):  # its own poles lie among the structure's
            found = self.loop.mode_poles(modes)
            freq, zeta = np.array([p.hz for p in found]), np.array([p.zeta for p in found])
        else:
            freq, zeta = self.loop.closed().modes(self.fe.linear.freq[list(modes)])
        least = min(self.loop.poles(), key=lambda pole: pole.zeta)
        return {
            "gains": linear_gains(self.law, self.loop.rate),
            "frequencies_hz": freq,
            "damping_ratios": zeta,
            "performance_indices": self._indices(modes, asked),
            "objective": {
                "name": f"smallest damping ratio of the sampled loop, at {least.hz:.4g} Hz",
                "value": least.zeta,
                "unit": "1",
            },
        }

    def _indices(self, modes: tuple[int, ...], asked: Asked) -> list[float | None]:
        """Return (4.33) without delay, if it applies."""
        model = state_model(self.fe)
        A, _, _, D = self.law.matrices
        same = self.law.sensors == model.channels and self.law.actuators == model.channels
        if len(A) or not same or np.linalg.eigvals(model.A + model.B @ D @ model.C).real.max() >= 0:
            return [None] * len(modes)
        x0 = performance.initial_states(model, modes)
        return list(performance.rate_feedback_index(model, -D, weights_of(asked, model), x0))


def load_law_argument(fe: FeModel, name: str, rate: float | None) -> LawArgument:
    """Load a law into the sampled loop of the laboratory.

    Parameters
    ----------
    fe : FeModel
        FE model.
    name : str
        Name of the law.
    rate : float or None
        Sample rate [Hz]; None for that of the law or the laboratory.

    Returns
    -------
    LawArgument
        Law in its loop.

    Raises
    ------
    BadController
        The law is not linear, or does not fit the structure or the rate.
    """
    law = named_law(fe.structure, name, code=[code_of(name)])
    if not isinstance(law, LinearController):
        raise BadController(
            f"the law {name} has no `matrices`: poles and damping ratios are those of linear laws; run vlab experiment instead"
        )
    return LawArgument(law=law, loop=loop_on(fe, law, laboratory_for(law, rate).converter), fe=fe)


def laboratory_for(law: LinearController | None, rate: float | None) -> Hardware:
    """Return the laboratory's hardware at a rate [Hz]."""
    hardware, chosen = load_hardware(), rate or getattr(law, "rate", None)
    return hardware.at_rate(chosen) if chosen else hardware


def linear_gains(law: LinearController, rate: float) -> dict[str, Any]:
    """Return the matrices of a linear law as plain data."""
    places = {"sensors": list(law.sensors), "actuators": list(law.actuators)}
    return {**places, **dict(zip("ABCD", law.matrices, strict=True)), "unit": "SI", "rate_hz": rate}
