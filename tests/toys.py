"""Small models with closed-form answers, in the form that designs take."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from vlab.fe.damping import driven_modes
from vlab.fe.second_order import SecondOrderModel
from vlab.lab.prediction import SampledLoop


def toy(M: Any, C: Any, K: Any, coils: Any) -> Any:
    """Return masses, dashpots and springs with coils, as a design sees an FE model."""
    n, coils = len(M), np.array(coils, dtype=float)
    linear = SecondOrderModel(
        M=np.array(M), C=np.array(C), K=np.array(K), coordinates=tuple(f"v:{i}" for i in range(n))
    )
    names = [SimpleNamespace(name=f"coil{i}", at=f"coil{i}") for i in range(coils.shape[1])]
    measured = driven_modes(coils.T @ linear.eigen[1])
    return SimpleNamespace(
        linear=linear, coils=coils, measured=measured, structure=SimpleNamespace(name="toy", coil=names)
    )


def oscillators(omega: Any, coils: Any, zeta: float = 0.0) -> Any:
    """Return unit masses on springs that do not know of each other."""
    omega = np.asarray(omega, dtype=float)
    return toy(np.eye(len(omega)), np.diag(2 * zeta * omega), np.diag(omega**2), coils)


def single_mode(laboratory, *, gain=2.0, rate=2000.0, delay=1.35, corner=677.0, zeta=0.01, hz=20.0) -> SampledLoop:
    """Return the sampled loop of one mode of unit mass with a collocated dashpot of this gain."""
    highest = max(rate, laboratory.converter.highest_rate)
    parts = replace(laboratory.converter, rate=rate, highest_rate=highest, delay_samples=delay, filter_corner=corner)
    omega = np.array([2 * np.pi * hz])
    law = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[-gain]]))
    return SampledLoop(
        omega=omega,
        damping=np.diag(2 * zeta * omega),
        at_coils=np.eye(1),
        at_sensors=np.eye(1),
        law=law,
        converter=parts,
    )
