"""Models and designs of one structure, shared by several tables."""

from functools import cached_property

import numpy as np

from vlab.controllers import lqdrf, lqg, mfdrf
from vlab.controllers.lqdrf import LqdrfDesign
from vlab.controllers.lqg import LqgDesign
from vlab.controllers.mfdrf import MfdrfDesign
from vlab.design import performance
from vlab.design.closed_loop import RateFeedbackLoop
from vlab.design.published_tables import published_design, published_table
from vlab.design.state_model import StateModel, state_model
from vlab.design.weights import noise_of, weights_of
from vlab.fe.model import FeModel
from vlab.fe.reduced import build_reduced_model
from vlab.signals import Array
from vlab.structure import load_structure
from vlab.structure.model import Structure


class Study:
    """Structure with cached models and published designs.

    Parameters
    ----------
    name : str
        ``"beam"`` or ``"grid"``.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._models: dict[str, FeModel] = {}
        self._states: dict[str, StateModel] = {}
        self._laws: dict[tuple[str, str], LqgDesign] = {}

    @cached_property
    def structure(self) -> Structure:
        """The structure."""
        return load_structure(self.name)

    def fe(self, model: str = "full") -> FeModel:
        """Return a model by its name (`vlab.fe.reduced.MODELS`)."""
        if model not in self._models:
            self._models[model] = build_reduced_model(self.structure, model)
        return self._models[model]

    def state(self, model: str = "full") -> StateModel:
        """Return a model in state form."""
        if model not in self._states:
            self._states[model] = state_model(self.fe(model))
        return self._states[model]

    def lqg(self, model: str, design: str = "identity") -> LqgDesign:
        """Return the LQG design on a model, with published weights.

        Its regulator is the LQR.
        """
        if (model, design) not in self._laws:
            asked, state = published_design(self.name, design), self.state(model)
            self._laws[model, design] = lqg.design(state, weights_of(asked, state), noise_of(asked, state))
        return self._laws[model, design]

    def mfdrf(self, model: str, design: str = "identity") -> MfdrfDesign:
        """Return a minimised maximum force design on a model."""
        asked = published_design(self.name, design)
        return mfdrf.design(self.fe(model), damping=asked.zeta_min, modes=asked.damped_modes)

    def lqdrf(self, model: str, design: str = "identity", *, diagonal: bool = False) -> LqdrfDesign:
        """Return a linear quadratic direct rate feedback design on a model.

        Parameters
        ----------
        model : str
            Name of the model.
        design : str
            Published design, for bounds and weights.
        diagonal : bool
            Whether the gain matrix is diagonal.

        Returns
        -------
        LqdrfDesign
            Design.
        """
        asked = published_design(self.name, design)
        return lqdrf.design(
            self.fe(model),
            weights_of(asked, self.state(model)),
            shapes=asked.index_modes,
            diagonal=diagonal,
            damping=asked.zeta_min,
            modes=asked.damped_modes,
        )

    def printed_gains(self, table: str, law: str) -> Array:
        """Return a printed gain matrix [N s/m] in order of the coils."""
        printed = published_table(self.name, table, law)
        channels = self.state().channels
        order = [printed.rows.index(name) for name in channels]
        return printed.si("N s/m")[np.ix_(order, order)]

    def rate_feedback_ratios(self, model: str, gains: Array, count: int) -> Array:
        """Return damping ratios of the first modes under u = -D y."""
        fe = self.fe(model)
        return RateFeedbackLoop(fe.linear, fe.coils).track(gains, count).zeta[0]

    def published_modes(self, count: int) -> Array:
        """Return the full model's modes of the first published ones."""
        return performance.shared_modes(self.state(), self.state("exact"))[:count]

    def rate_feedback_index(self, model: str, gains: Array, count: int, design: str = "identity") -> Array:
        """Return J of u = -D y for the first initial shapes (4.33)."""
        state = self.state(model)
        x0 = performance.initial_states(state, self.published_modes(count) if model == "full" else count)
        weights = weights_of(published_design(self.name, design), state)
        return performance.rate_feedback_index(state, gains, weights, x0)
