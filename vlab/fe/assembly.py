"""Assembly of the FE model of a structure."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vlab.errors import BadStructure
from vlab.fe import elements as el
from vlab.fe.damping import NO_SILENT, SILENT, SilentModes, modal_factors, modal_ratios
from vlab.fe.in_plane import Resultants, end_columns, in_plane_resultants
from vlab.fe.mesh import Element, Mesh, build_mesh
from vlab.fe.model import TUNING, FeModel, Piece, bending_map, torsion_map
from vlab.fe.one_mode import OneModeBar, one_mode_bar
from vlab.fe.second_order import SecondOrderModel
from vlab.fe.statics import HangingLine, cable_tensions, hanging_lines
from vlab.signals import Array
from vlab.structure.discretisation import Variant
from vlab.structure.model import Structure

_MOTIONS = ("v", "rx", "rz")
"""Motions of a node: deflection along y, rotation about x, rotation about z."""


def build_fe_model(structure: Structure, variant: str = "published", *, refine: int = 1) -> FeModel:
    """Assemble M, C and K of a structure's variant.

    Beams have consistent mass and a geometric stiffness with tension that grows with the weight below. Strings in
    tension are lateral springs T/L with a third of their mass. Inserts at clamps are rigid; modal ratios give the
    damping.

    Parameters
    ----------
    structure : Structure
        Structure.
    variant : str
        Name of a variant in the structure file.
    refine : int
        Factor on the variant's elements per span.

    Returns
    -------
    FeModel
        FE model with its pieces.
    """
    choice = structure.variant_named(variant)
    mesh = build_mesh(structure, choice, refine=refine)
    one_mode = one_mode_bar(structure, choice.one_mode_bar) if choice.one_mode_bar else None
    pieces = tuple(_pieces(structure, mesh, choice, one_mode))
    n = 3 * len(mesh.nodes) + (one_mode is not None)
    M, K = np.zeros((n, n)), np.zeros((n, n))
    for piece in pieces:
        M[np.ix_(piece.columns, piece.columns)] += piece.M
        K[np.ix_(piece.columns, piece.columns)] += piece.K
    keep = _moving(structure, mesh, M)
    names = [f"{_MOTIONS[i % 3]}:{mesh.nodes[i // 3].name}" for i in keep if i < 3 * len(mesh.nodes)]
    if one_mode is not None:
        names.append(f"tip:{one_mode.bar}")
    block = np.ix_(keep, keep)
    undamped = SecondOrderModel(M=M[block], C=np.zeros((len(keep), len(keep))), K=K[block], coordinates=tuple(names))
    model = FeModel(
        structure=structure,
        variant=variant,
        mesh=mesh,
        linear=undamped,
        expand=np.eye(len(M))[:, keep],
        one_mode=one_mode,
        pieces=_kept(pieces, keep),
        silent=silent_modes(structure, variant) if structure.span else NO_SILENT,
    )
    model = _tuned(model)
    zeta = modal_ratios(structure.damping, model.measured, model.linear.n)
    return replace(model, linear=model.linear.with_modal_damping(zeta))


def silent_modes(structure: Structure, variant: str, even: FeModel | None = None) -> SilentModes:
    """Return the silent modes of a structure without its deviating spans.

    Parameters
    ----------
    structure : Structure
        Structure.
    variant : str
        Variant of the model.
    even : FeModel, optional
        FE model without deviating spans and tuning, where it is known; built by default.

    Returns
    -------
    SilentModes
        Modes between the measured ones.
    """
    even = even or build_fe_model(replace(structure, span=(), tuning=None), variant)
    omega, shapes = even.linear.eigen
    rows, driven = even.deflections(even.points) @ shapes, even.measured
    last = driven[: max(len(structure.damping.ratios), _most_tuned(structure))][-1:].max(initial=-1)
    seen = np.abs(rows).max(axis=0)
    silent = [i for i in range(int(last)) if i not in driven and seen[i] > SILENT * seen.max()]
    return SilentModes(omega[silent], rows[:, silent])


def _most_tuned(structure: Structure) -> int:
    """Return the number of modes with tuned values."""
    tuning = structure.tuning
    return 0 if tuning is None else max(tuning.of_fe, len(tuning.frequencies))


def _tuned(model: FeModel) -> FeModel:
    """Return a model with tuned frequencies.

    The tuning stiffness is a piece of its own.
    """
    if model.structure.tuning is None:
        return model
    linear = model.linear
    K = linear.tuning_stiffness(modal_factors(model.structure.tuning, model.measured, linear.n))
    piece = Piece(name=TUNING, columns=tuple(range(linear.n)), M=np.zeros_like(K), K=K)
    return replace(model, linear=replace(linear, K=linear.K + K), pieces=(*model.pieces, piece))


def _kept(pieces: tuple[Piece, ...], keep: list[int]) -> tuple[Piece, ...]:
    """Return the pieces in the moving coordinates."""
    place = {column: i for i, column in enumerate(keep)}
    out = []
    for piece in pieces:
        inside = [k for k, column in enumerate(piece.columns) if column in place]
        if inside:
            block = np.ix_(inside, inside)
            columns = tuple(place[piece.columns[k]] for k in inside)
            out.append(Piece(piece.name, columns, piece.M[block], piece.K[block]))
    return tuple(out)


def _pieces(structure: Structure, mesh: Mesh, variant: Variant, one_mode: OneModeBar | None) -> Iterator[Piece]:
    """Yield the parts of mass and stiffness.

    The parts are elements, points, cables and plates.
    """
    lines = hanging_lines(structure)
    hanging = in_plane_resultants(structure, mesh)
    for i, element in enumerate(mesh.elements):
        m, k = _element_matrices(element, mesh, lines.get(element.bar))
        if i in hanging:
            k += _hanging_stiffness(element, mesh, hanging[i], variant)
        yield Piece(f"{element.bar}:{i}", tuple(end_columns(element)), m, k)
    yield from _points(structure, mesh)
    if one_mode is not None:
        columns = (3 * mesh.node(one_mode.root), 3 * len(mesh.nodes))
        yield Piece(one_mode.bar, columns, one_mode.mass_matrix, one_mode.stiffness_matrix)
    if variant.in_plane_moments:
        K = _hanging_moments(structure, mesh, set(lines))
        moved = tuple(np.flatnonzero(np.any(K, axis=0)).tolist())
        if moved:
            yield Piece("weight of crossing bars", moved, np.zeros((len(moved),) * 2), K[np.ix_(moved, moved)])


def _points(structure: Structure, mesh: Mesh) -> Iterator[Piece]:
    """Yield masses, cables and plates at their nodes."""
    tensions = cable_tensions(structure)
    for point in structure.point:
        if point.name not in {node.name for node in mesh.nodes}:
            continue
        node = 3 * mesh.node(point.name)
        M, K = np.zeros(3), np.zeros(3)
        M[0] = structure.point_mass(point.name)
        M[1:] += sum(mass.rotary_inertia for mass in structure.mass if mass.at == point.name)
        for cable in (c for c in structure.cable if c.at == point.name):
            K[0] += tensions[cable.name] / abs(cable.height)  # sum of T_i/L_i: the inclination cancels
        for plate in (p for p in structure.plate if p.at == point.name):
            K[1] += plate.weight_moment
            M[1:] += [plate.inertia_about_beam, plate.inertia_about_vertical]
        yield Piece(point.name, (node, node + 1, node + 2), np.diag(M), np.diag(K))


def _hanging_stiffness(element: Element, mesh: Mesh, resultants: Resultants, variant: Variant) -> Array:
    """Return the geometric stiffness of in-plane forces, 6 x 6.

    The forces are those of gravity; the coordinates are (v, rx, rz) of both nodes.
    """
    L, direction = element.length, mesh.direction(element)
    bend, twist = bending_map(direction), torsion_map(direction)
    k = bend.T @ el.geometric_stiffness(resultants.axial_at(0.0), resultants.axial_at(L), L) @ bend
    if variant.in_plane_moments:
        both = np.vstack([bend, twist])
        k += both.T @ el.moment_stiffness(resultants.moment_at, L, variant.moment_boundary_factor) @ both
    return np.asarray(k)


def _hanging_moments(structure: Structure, mesh: Mesh, vertical: set[str]) -> Array:
    """Return the stiffness from the weight of a crossing bar.

    The bar is clamped across a vertical one. If the clamp rolls by rx, the arms deflect along a tilted axis. The
    deflection times rx lifts their weight: the potential is g rx (sum of m (v - v_clamp)). The mechanism is the
    in-plane bending moment of the arms.
    """
    n = 3 * len(mesh.nodes)
    K = np.zeros((n, n))
    for clamp in structure.clamp:
        root = 3 * mesh.node(clamp.at)
        for bar in (b for b in structure.bar if clamp.at in b.points and b.name not in vertical):
            weight = np.zeros(n)
            for element in (e for e in mesh.elements if e.bar == bar.name):
                mass = _element_matrices(element, mesh, None)[0]
                weight[end_columns(element)] += structure.gravity * mass @ np.array([1.0, 0, 0, 1.0, 0, 0])
            for name in bar.points:
                if name != clamp.at:
                    weight[3 * mesh.node(name)] += structure.gravity * structure.point_mass(name)
            weight[root] -= weight[::3].sum()
            weight[root + 1 : root + 3] = 0.0  # mass that turns with the clamp is not lifted to first order
            K[root + 1] += weight
            K[:, root + 1] += weight
    return K


def _element_matrices(element: Element, mesh: Mesh, line: HangingLine | None) -> tuple[Array, Array]:
    section, flexible = element.section, element.flexible
    if flexible <= 0:
        raise BadStructure(
            f"bar {element.bar!r}: the clamps leave no flexible length in a span of {element.length:g} m"
        )
    direction = mesh.direction(element)
    start_tension = end_tension = start_rigid_tension = end_rigid_tension = 0.0
    if line is not None:
        lower, upper = sorted((mesh.nodes[element.start].z, mesh.nodes[element.end].z))
        above_lower, at_upper = line.tension(lower), line.tension(lower) + line.weight(lower, upper)
        low, high = (above_lower, at_upper) if direction[1] > 0 else (at_upper, above_lower)
        share = np.array([element.rigid_start, element.length - element.rigid_end]) / element.length
        start_tension, end_tension = low + (high - low) * share
        start_rigid_tension, end_rigid_tension = (low + start_tension) / 2, (high + end_tension) / 2
    k = el.bending_stiffness(section.bending_stiffness, flexible, section.shear_stiffness) + el.geometric_stiffness(
        start_tension, end_tension, flexible
    )
    m = el.consistent_mass(section.mass_per_length, flexible)
    T = el.rigid_end(element.rigid_start, element.rigid_end)
    k, m = T.T @ k @ T, T.T @ m @ T
    for where, length, tension in (
        (0, element.rigid_start, start_rigid_tension),
        (2, -element.rigid_end, end_rigid_tension),
    ):
        if length:
            rigid_m, rigid_k = el.rigid_segment(section.mass_per_length, tension, length)
            m[where : where + 2, where : where + 2] += rigid_m
            k[where : where + 2, where : where + 2] += rigid_k
    bend = bending_map(direction)
    k, m = bend.T @ k @ bend, bend.T @ m @ bend
    if section.torsion_stiffness:
        twist = torsion_map(direction)
        k += twist.T @ el.torsion_stiffness(section.torsion_stiffness, element.length) @ twist
        m += twist.T @ el.torsion_mass(section.polar_inertia_per_length, element.length) @ twist
    return m, k


def _moving(structure: Structure, mesh: Mesh, M: Array) -> list[int]:
    """Return the motions with mass.

    A motion without mass or stiffness is dropped. A bar without torsional stiffness does not hold the rotation about
    its own axis. At a clamp on a vertical bar such a rotation would be free, so the model holds the rotation: the
    vertical bar does not twist.
    """
    massive = [i for i in range(len(M)) if M[i, i] > 1e-14 * M.diagonal().max()]
    vertical = set(hanging_lines(structure))
    held = {
        3 * mesh.node(clamp.at) + 2
        for clamp in structure.clamp
        for bar in structure.bar
        if clamp.at in bar.points and bar.name in vertical and not structure.section[bar.section].torsion_stiffness
    }
    motions = {"v": 0, "rx": 1, "rz": 2}
    held |= {3 * mesh.node(s.at) + motions[motion] for s in structure.support for motion in s.holds}
    return [i for i in massive if i not in held]
