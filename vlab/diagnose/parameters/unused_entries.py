"""Entries of ``[model.uncertain]`` that change nothing in a case."""

from collections.abc import Mapping, Sequence

from vlab.diagnose.parameters.mjcf import Uncertain


def unused(given: Mapping[str, float], parameters: Sequence[Uncertain]) -> list[str]:
    """Return a note on unused entries of ``[model.uncertain]``.

    Parameters
    ----------
    given : mapping
        ``[model.uncertain]`` of the case.
    parameters : sequence of Uncertain
        Uncertain parameters.

    Returns
    -------
    list of str
        One note, or none.
    """
    kinds, names = {p.kind for p in parameters}, {p.name for p in parameters}
    stated = [name for name in given if not name.startswith("geom:")]  # geom masses belong to bodies
    idle = [name for name in stated if not (_meant(name) & names if ":" in name else name in kinds)]
    if not idle:
        return []
    return [f"[model.uncertain] {', '.join(idle)}: not used, nothing of that kind or name is uncertain in this case"]


def _meant(name: str) -> set[str]:
    """Return the names of parameters that a stated name can refer to."""
    kind, _, rest = name.partition(":")
    element, _, quantity = rest.rpartition(":")
    return {
        "actuator": {f"{quantity}:{element}"},
        "sensor": {f"sensor:{element}", f"sensor:sensor:{element}"},
        "body": {name, f"body:{element}:mass"} if quantity == "inertia" else {name},
    }.get(kind, {name})
