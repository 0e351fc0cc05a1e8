"""Small models with closed-form answers, in the form that designs take."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from vlab.fe.second_order import SecondOrderModel


def toy(M: Any, C: Any, K: Any, coils: Any) -> Any:
    """Return masses, dashpots and springs with coils, as a design sees an FE model."""
    n, coils = len(M), np.array(coils, dtype=float)
    linear = SecondOrderModel(
        M=np.array(M), C=np.array(C), K=np.array(K), coordinates=tuple(f"v:{i}" for i in range(n))
    )
    names = [SimpleNamespace(name=f"coil{i}", at=f"coil{i}") for i in range(coils.shape[1])]
    return SimpleNamespace(linear=linear, coils=coils, structure=SimpleNamespace(name="toy", coil=names))


def oscillators(omega: Any, coils: Any, zeta: float = 0.0) -> Any:
    """Return unit masses on springs that do not know of each other."""
    omega = np.asarray(omega, dtype=float)
    return toy(np.eye(len(omega)), np.diag(2 * zeta * omega), np.diag(omega**2), coils)
