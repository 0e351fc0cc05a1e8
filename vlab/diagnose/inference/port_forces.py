"""Forces of effects along the filtered motion at ports.

Hysteretic laws are integrated for all ports at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.diagnose.inference.reference_scales import Motion
from vlab.diagnose.parameters.locations import Place, admissible
from vlab.diagnose.predictors.innovations import Group
from vlab.diagnose.predictors.unit_causes import series_at_ports
from vlab.diagnose.predictors.unit_effects import port_series
from vlab.physics.effect import PortEffect
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PortForces:
    """Forces of laws along the filtered motion.

    Parameters
    ----------
    places : sequence of Place
        Locations of the problem.
    motion : callable
        Displacement and velocity at a port.
    shapes : callable
        Trial shapes of an effect at a location.
    kept : dict
        Forces of hysteretic laws at all ports, by batch, effect and amplitudes; extended by every new law.
    """

    places: Sequence[Place]
    motion: Motion
    shapes: Callable[[PortEffect, Place], list[dict[str, float]]]
    kept: dict[tuple[Any, ...], Array]

    def along(self, group: Group, place: Place, effect: PortEffect, values: dict[str, float]) -> Array:
        """Return an effect's force along the motion.

        Parameters
        ----------
        group : Group
            Filtered runs.
        place : Place
            Port.
        effect : PortEffect
            Law.
        values : dict
            Parameter values.

        Returns
        -------
        (n, n_runs) array
            Force [SI].
        """
        if effect.memory((1,)) is not None:
            known = self._of_all_ports(group, place, effect, values)
            if known is not None:
                return known
        z, v = self.motion(group, place)
        command: Any = group.u[..., place.coil] if place.coil is not None else 0.0
        return port_series(effect, z, v, values, group.h, command, group.starts)

    def _of_all_ports(self, group: Group, place: Place, effect: PortEffect, values: dict[str, float]) -> Array | None:
        """Return a hysteretic law's force; None for other than trial shapes."""
        ports = [p for p in self.places if p.kind == "port" and admissible(effect, p)]
        shapes = [self.shapes(effect, p) for p in ports]
        at = next((i for i, p in enumerate(ports) if p.name == place.name), -1)
        shape = {p.name: values[p.name] for p in effect.shapes}
        if at < 0 or shape not in shapes[at]:
            return None
        amplitudes = {p.name: values[p.name] for p in effect.amplitudes}
        key = (id(group), effect.name, tuple(amplitudes.values()))
        if key not in self.kept:
            motions = [self.motion(group, p) for p in ports]
            self.kept[key] = series_at_ports(effect, motions, shapes, amplitudes, group)
        return np.asarray(self.kept[key][..., at, shapes[at].index(shape)])
