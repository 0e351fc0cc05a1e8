"""FE plant: matrices of an FE model in MuJoCo, element by element.

The coordinates are slide joints on bodies of negligible mass, nested as the elimination tree of the FE matrices. Each
element becomes fixed tendons. The eigenvectors of K_e x = lambda M_e x, scaled to x^T M_e x = 1, give rows c = M_e x.
Then M_e = sum c c^T and K_e = sum lambda c c^T. One tendon with coefficients c, armature 1 and stiffness lambda
therefore carries both. K_e includes the geometric stiffness of gravity; a negative lambda is allowed. MuJoCo drops
off-diagonal inertia between branches. In the elimination tree the coordinates of an element lie on one branch.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from scipy import linalg

from vlab.fe.model import TUNING, FeModel, Piece
from vlab.plants.base import Plant
from vlab.plants.mode_by_mode import modal_dampers, rank_one, tuning_springs, with_modal_tendons
from vlab.plants.tendon_points import LINEAR, add_carrier, add_points, fe_element_ports, linear_spec, point_plant

ROOM = 1.8
"""ROOM [1]: largest product of highest circular frequency and time step. The explicit stability limit is 2."""


def elimination_tree(cliques: Sequence[Sequence[int]], n: int) -> list[int]:
    """Return the parent of every coordinate, -1 for roots.

    The tree is the elimination tree of the matrix with the given cliques, in minimum-degree order [1]_. The coordinates
    of a clique lie on one path to the root. A kinematic tree of the same shape has room for every off-diagonal mass
    term, and the order keeps further terms few. MuJoCo's factorisation then fills in little.

    Parameters
    ----------
    cliques : sequence of sequence of int
        Coordinates of each element.
    n : int
        Number of coordinates.

    Returns
    -------
    list of int
        Parents, length n.

    References
    ----------
    .. [1] T. A. Davis, *Direct Methods for Sparse Linear Systems*, SIAM, 2006, sections 4.1 and 7.1.
    """
    near: list[set[int]] = [set() for _ in range(n)]
    for clique in cliques:
        for a in clique:
            near[a] |= set(clique) - {a}
    left = set(range(n))
    rank: dict[int, int] = {}
    filled: dict[int, set[int]] = {}
    while left:
        column = min(left, key=lambda c: (len(near[c]), c))
        left.remove(column)
        rank[column] = len(rank)
        filled[column] = set(near[column])
        for a in near[column]:
            near[a] |= near[column] - {a}
            near[a].discard(column)
    return [min(filled[c], key=rank.__getitem__, default=-1) for c in range(n)]


def _depth(parents: Sequence[int], column: int) -> int:
    return 0 if parents[column] < 0 else 1 + _depth(parents, parents[column])


def build_fe_plant(fe: FeModel, *, timestep: float = 5e-4) -> Plant:
    """Build the FE plant of an FE model.

    Selective mass scaling slows modes too fast for the step. M + e K in place of M turns omega^2 into omega^2/(1 + e
    omega^2). The highest frequency is then bounded, and low frequencies stay. At a step of 0.5 ms e is below 8e-8, a
    change of 1.5e-4 of the frequency at 10 Hz. The scaling costs nothing: the armature of an element's tendons becomes
    1 + e lambda.

    Parameters
    ----------
    fe : FeModel
        FE model.
    timestep : float
        Integration step [s].

    Returns
    -------
    Plant
        Plant at equilibrium.
    """
    highest = float(fe.linear.eigen[0][-1])
    scaling = max(0.0, (timestep / ROOM) ** 2 - 1.0 / highest**2)
    spec = linear_spec(f"{fe.structure.name} fe ({fe.variant})", timestep)
    parents = elimination_tree([piece.columns for piece in fe.pieces if np.any(piece.M)], fe.linear.n)
    bodies: dict[int, Any] = {-1: spec.worldbody}
    for column in sorted(range(fe.linear.n), key=lambda c: _depth(parents, c)):
        name = fe.linear.coordinates[column]
        bodies[column] = add_carrier(bodies[parents[column]], name)
        bodies[column].add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0])
    tuning = next((piece.K for piece in fe.pieces if piece.name == TUNING), None)
    for piece in fe.pieces:
        if piece.name != TUNING:
            _add_piece(spec, piece, fe.linear.coordinates, scaling)
    places = dict.fromkeys([p.name for p in fe.structure.point] + fe.structure.transducer_places)
    rows = {place: fe.deflection(place) for place in places}
    add_points(spec, fe.structure, rows, fe.linear.coordinates)
    model = spec.compile()
    order = [
        fe.linear.coordinates.index(model.joint(k).name) for k in range(model.njnt)
    ]  # MuJoCo numbers coordinates branch by branch
    listed = [fe.linear.coordinates.index(joint.name) for joint in spec.joints]
    tendons = modal_dampers(fe.linear, fe.linear.zeta)
    if tuning is not None:
        tendons += tuning_springs(tuning)
    written = with_modal_tendons(spec, [replace(t, row=t.row[listed]) for t in tendons])
    slowed = (f"modes above {0.3 / np.sqrt(scaling) / 2 / np.pi:.0f} Hz are slowed",) if scaling else ()
    left_out = (LINEAR, *slowed)
    ordered = {place: row[order] for place, row in rows.items()}
    return point_plant(
        "fe",
        spec,
        fe.structure,
        ordered,
        left_out=left_out,
        elements=fe_element_ports(fe, ordered, lambda row: row[order]),
        written=written,
        dissipation=fe.linear.C[np.ix_(order, order)],
        restoring=None if tuning is None else tuning[np.ix_(order, order)],
    )


def _add_piece(spec: Any, piece: Piece, names: tuple[str, ...], scaling: float) -> None:
    massive = np.flatnonzero(piece.M.diagonal() > 0)
    if len(massive) == len(piece.M):
        values, vectors = linalg.eigh(piece.K, piece.M)
        rows = (piece.M @ vectors).T
        parts = [(value, 1.0 + scaling * max(value, 0.0), row) for value, row in zip(values, rows, strict=True)]
    else:  # a coordinate without mass: stiffness and mass separately
        parts = [(value, scaling * max(value, 0.0), row) for value, row in rank_one(piece.K)] + [
            (0.0, value, row) for value, row in rank_one(piece.M)
        ]
    for k, (stiffness, inertia, row) in enumerate(parts):
        tendon = spec.add_tendon(name=f"{piece.name}:{k + 1}")
        tendon.stiffness[0], tendon.armature = stiffness, inertia
        for column, coefficient in zip(piece.columns, row, strict=True):
            if abs(coefficient) > 1e-14 * np.abs(row).max():
                tendon.wrap_joint(names[column], coefficient)
