"""In-plane statics of hung bars: axial force and moment from gravity.

Every span is a cantilever from its first point, with the axis t and the normal n. The normal is (t_z, -t_x). Forces P
and Q along t and n and a moment C at the far end give

    N(s) = P + q_t (L - s),    EI u''(s) = C + Q (L - s) + q_n (L - s)^2 / 2

with the weights q_t and q_n per length. The end displacement is the integral of these resultants over the flexibilities
1/EA and 1/EI. Its inverse is the stiffness of the span. Resultants are exact for even bars of any length.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from vlab.errors import BadStructure
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Span:
    """Straight bar between two points in the plane.

    Parameters
    ----------
    start, end : str
        Names of its points.
    axial, bending : float
        Stiffness EA [N] and in-plane EI [N m^2].
    weight : float
        Weight per length [N/m].
    """

    start: str
    end: str
    axial: float
    bending: float
    weight: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Resultants:
    """Axial force and in-plane moment along a span.

    Parameters
    ----------
    far : (3,) array
        Force along t, force along n [N] and moment [N m] at the far end.
    load : (float, float)
        Weight along t and along n [N/m].
    """

    far: Array
    load: tuple[float, float]
    length: float

    def axial(self, s: Array) -> Array:
        """Return the axial force at stations; tension is positive.

        Parameters
        ----------
        s : array
            Distance from the first point [m].

        Returns
        -------
        array
            Axial force [N].
        """
        return np.asarray(self.far[0] + self.load[0] * (self.length - s))

    def moment(self, s: Array) -> Array:
        """Return the moment at stations.

        A positive moment pulls the fibres on the side of n.

        Parameters
        ----------
        s : array
            Distance from the first point [m].

        Returns
        -------
        array
            Moment [N m].
        """
        rest = self.length - s
        return np.asarray(-(self.far[2] + self.far[1] * rest + self.load[1] * rest**2 / 2))


def hung_frame(
    spans: tuple[Span, ...],
    position: Callable[[str], tuple[float, float]],
    weights: dict[str, float],
    pinned: set[str],
) -> list[Resultants]:
    """Solve the plane frame that hangs from pinned points.

    Parameters
    ----------
    spans : tuple of Span
        Bars between points, rigidly joined.
    position : callable
        Name of a point to its (x, z) [m].
    weights : dict of str to float
        Weights at points [N].
    pinned : set of str
        Points held in x and z that may rotate.

    Returns
    -------
    list of Resultants
        Resultants of every span.

    Raises
    ------
    BadStructure
        The frame is a mechanism.
    """
    names = list(dict.fromkeys(name for span in spans for name in (span.start, span.end)))
    index = {name: 3 * i for i, name in enumerate(names)}
    K, load = np.zeros((3 * len(names),) * 2), np.zeros(3 * len(names))
    parts = [_cantilever(span, position) for span in spans]
    for span, part in zip(spans, parts, strict=True):
        columns = [index[name] + i for name in (span.start, span.end) for i in range(3)]
        K[np.ix_(columns, columns)] += part.pull.T @ part.stiffness @ part.pull
        load[columns] += part.pull.T @ part.stiffness @ part.sag + part.own
    for name in names:
        load[index[name] + 1] -= weights.get(name, 0.0)
    held = {index[name] + i for name in names if name in pinned for i in range(2)}
    free = [i for i in range(len(load)) if i not in held]
    block = K[np.ix_(free, free)]
    if not held or np.linalg.cond(block) > 1e14:
        raise BadStructure("the hung bars are a mechanism in the plane; hang them from more points")
    motion = np.zeros(len(load))
    motion[free] = np.linalg.solve(block, load[free])
    out = []
    for span, part in zip(spans, parts, strict=True):
        columns = [index[name] + i for name in (span.start, span.end) for i in range(3)]
        far = part.stiffness @ (part.pull @ motion[columns] - part.sag)
        out.append(Resultants(far=far, load=part.load, length=part.length))
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cantilever:
    """Far-end stiffness of a span, and its map from the motion of both points.

    Parameters
    ----------
    stiffness : (3, 3) array
        Force (P, Q, C) per displacement of the far end.
    pull : (3, 6) array
        Displacement of the far end by (x, z, rotation) of both points.
    sag : (3,) array
        Displacement of the far end by the weight alone.
    own : (6,) array
        Nodal load of the weight on the cantilever.
    """

    stiffness: Array
    pull: Array
    sag: Array
    own: Array
    load: tuple[float, float]
    length: float


def _cantilever(span: Span, position: Callable[[str], tuple[float, float]]) -> _Cantilever:
    a, b = np.array(position(span.start)), np.array(position(span.end))
    L = float(np.hypot(*(b - a)))
    tx, tz = (b - a) / L
    along, across = -span.weight * tz, span.weight * tx
    xi, weight = legendre.leggauss(4)  # exact to degree 7: the largest one is 4
    flexible, sag = np.zeros((3, 3)), np.zeros(3)
    soft = np.diag([1.0 / span.axial, 1.0 / span.bending])
    for rest, w in zip((1.0 - xi) * L / 2.0, weight * L / 2.0, strict=True):
        inside = np.array([[1.0, 0.0, 0.0], [0.0, rest, 1.0]])
        flexible += w * inside.T @ soft @ inside
        sag += w * inside.T @ soft @ np.array([along * rest, across * rest**2 / 2])
    local = np.array([[tx, tz, 0.0], [tz, -tx, 0.0], [0.0, 0.0, 1.0]])
    carry = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, L], [0.0, 0.0, 1.0]])
    own = np.concatenate([local.T @ np.array([along * L, across * L, across * L**2 / 2]), np.zeros(3)])
    return _Cantilever(
        stiffness=np.linalg.inv(flexible),
        pull=np.hstack([-carry @ local, local]),
        sag=sag,
        own=own,
        load=(float(along), float(across)),
        length=L,
    )
