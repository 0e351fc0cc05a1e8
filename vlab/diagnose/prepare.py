"""From a case to what the search works on: the twin, the runs on one clock, the places."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vlab.cases.case import Case
from vlab.cases.initial import replayed_commands
from vlab.cases.playback import bench_for, plan_clock
from vlab.cases.wiring import ORDER, Compared, Law, Run
from vlab.diagnose.hum import Hum, find_hum, without_hum
from vlab.diagnose.linear_view import actuator_forces, channel_rows, command_readings, within_limits
from vlab.diagnose.places import FREE, Place, places_of
from vlab.diagnose.signals import Seen, Signals, fastest, signals_of, uniform
from vlab.diagnose.twin import Change, Part, Twin, observable
from vlab.diagnose.uncertain import Uncertain, adjusted, derivative, uncertain_parameters, unused
from vlab.diagnose.uncertain_structure import adjusted_structure, structure_parameters, structure_parts
from vlab.errors import BadCase
from vlab.fe.damping import driven_modes
from vlab.fe.second_order import SecondOrderModel
from vlab.physics.running import STAGGERED
from vlab.plants.base import Plant
from vlab.signals import Array

MOST_MODES = 24
MODEL_ERROR, MESH_ERROR = 0.002, 0.005
"""Of a user's model that is integrated well; of the two structures, whose meshes and sensors' places are known less well."""
INTEGRATION_ERROR = 5e-4
"""What integration leaves of a user's model where nothing is missing."""
MESH_OWN_ERROR = 0.025
"""What a structure's mesh and the places of its sensors do leave after a refit. It is more than the weights allow for: these say
what a fit should strive for, this what its success is worth."""
BAND_MARGIN = 2.0
"""Modes up to this multiple of the fastest motion recorded are kept: those above follow statically."""
LAGGING = 30.0
"""A lag turns phases far below its corner: by 2 degrees at one part in so many of it."""
LEAST_SAMPLES = 64
"""What a spectrum takes from which the noise is read."""
LONG = 0.9
"""Less than this share of a recording searched is worth saying."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """A case as the search sees it.

    Parameters
    ----------
    channels : tuple of Compared
        All channels that are compared in some run, commands aside.
    names : tuple of str
        Their names.
    runs : tuple of Run
        As wired.
    signals : tuple of Signals
        The same runs on the search's clock, in the same order, hum taken off.
    orders : tuple of int
        How often every channel is the derivative of a position.
    about : (n_channels,) array
        Readings from which sensors' gains count: those at rest, of which nobody knows how much is the zero.
    hums : tuple of Hum
        The hum that was found on their channels.
    highest_hz : float
        Frequency below which nearly all power of the recorded velocities lies.
    intensity : mapping of float to float
        Of the forces that the twin lacks, by sample period [s], where a filter was tuned before; see `observer.tune`.
    """

    case: Case
    plant: Plant
    twin: Twin
    parameters: tuple[Uncertain, ...]
    channels: tuple[Compared, ...]
    names: tuple[str, ...]
    runs: tuple[Run, ...]
    orders: tuple[int, ...]
    about: Array
    signals: tuple[Signals, ...]
    places: tuple[Place, ...]
    hums: tuple[Hum, ...] = ()
    highest_hz: float = np.inf
    intensity: Mapping[float, float] = field(default_factory=dict)

    @property
    def model_error(self) -> float:
        """Error of the simulation itself that is allowed for in the weights, as a share of a channel's rms."""
        return MODEL_ERROR if self.case.structure is None else MESH_ERROR

    @property
    def own_error(self) -> float:
        """Error that the model itself leaves where nothing is missing, as a share of a channel's rms, at least."""
        return INTEGRATION_ERROR if self.case.structure is None else MESH_OWN_ERROR

    @property
    def notes(self) -> tuple[str, ...]:
        """What must be said of the search: parts of recordings that it did not look at, what was stated and not used."""
        out = []
        for run, part in zip(self.runs, self.signals, strict=True):
            whole = float(run.measured.time[-1] - run.measured.time[0])
            if part.last_s - part.t0 < LONG * whole:
                out.append(
                    f"{run.name}: searched from {part.t0:.4g} to {part.last_s:.4g} s of {whole:.4g} s; the verdict is on all of it"
                )
        out += unused(self.case.table.model.uncertain, self.parameters)
        return (*out, *getattr(self.plant, "notes", ()))

    def adjusted(self, theta: Array) -> Plant:
        """Return the plant with its uncertain parameters at given log-factors."""
        if self.case.structure is None:
            return adjusted(self.plant, self.parameters, theta)
        return adjusted_structure(
            self.case.structure, self.plant, self.case.table.model.variant, self.parameters, theta
        )

    def in_role(self, role: str) -> list[Signals]:
        """Return the runs of one role."""
        return [s for s in self.signals if s.role == role]


@dataclass(frozen=True, kw_only=True, eq=False)
class Wired:
    """The runs of a case that compare the same channels, and what drives them.

    Parameters
    ----------
    channels : tuple of Compared
        Commands aside.
    load_ports : tuple of str
        Ports that recordings drive directly.
    driven : tuple of int
        Actuators that recordings or laws drive.
    """

    runs: tuple[Run, ...]
    channels: tuple[Compared, ...]
    load_ports: tuple[str, ...]
    driven: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(c.channel for c in self.channels)

    @property
    def orders(self) -> tuple[int, ...]:
        """How often every channel is the derivative of a position."""
        measured = self.runs[0].measured
        return tuple(ORDER.get(measured.channels[measured.index(name)].kind, 0) for name in self.names)

    @property
    def highest_hz(self) -> float:
        """The frequency below which nearly all power of the recorded velocities lies."""
        data = [(np.column_stack([run.measured[name] for name in self.names]), run.measured.time) for run in self.runs]
        return max(fastest(y, uniform(time), self.orders) for y, time in data)


def wired_runs(case: Case, roles: Sequence[str]) -> Wired:
    """Return a case's runs in some roles.

    Raises
    ------
    BadCase
        No recording, one that is too short, or runs that compare different channels.
    """
    runs = tuple(case.runs(roles))
    if not runs:
        only = ", or one of the [[frf]] and [[modal]] as fit" if case.table.frf or case.table.modal else ""
        raise BadCase(f"{case.path}: no [[recording]] has the role {' or '.join(roles)}; mark at least one{only}")
    short = next((run for run in runs if len(run.measured) < LEAST_SAMPLES), None)
    if short is not None:
        raise BadCase(
            f"{case.path}: {short.name} has {len(short.measured)} samples; at least {LEAST_SAMPLES} tell motion from noise"
        )
    channels = tuple(c for c in runs[0].compared if c.actuator is None)
    for run in runs[1:]:
        if tuple(c for c in run.compared if c.actuator is None) != channels:
            raise BadCase(
                f"{case.path}: {run.name} compares other channels than {runs[0].name}; give them the same ones"
            )
    by_law = {i for run in runs if run.law is not None for i in run.law.actuators}
    return Wired(
        runs=runs,
        channels=channels,
        load_ports=tuple(dict.fromkeys(d.port for run in runs for d in run.drives if d.port)),
        driven=tuple(sorted({d.actuator for run in runs for d in run.drives if d.actuator is not None} | by_law)),
    )


def prepare(case: Case, roles: Sequence[str] = ("fit",)) -> Problem:
    """Prepare a case's recordings in some roles.

    Raises
    ------
    BadCase
        No recording, or runs that compare different channels.
    """
    wired = wired_runs(case, roles)
    runs, channels, names = wired.runs, wired.channels, wired.names
    load_ports, driven = wired.load_ports, wired.driven
    plant = case.plant
    orders = wired.orders
    linear = plant.linearise()
    rows = channel_rows(plant, channels)
    highest = wired.highest_hz
    omega, shapes = linear.eigen
    rate = min(1 / uniform(run.measured.time) for run in runs)
    kept = observable(rows.onto(np.eye(plant.model.nv)), shapes, omega)
    band = 2 * np.pi * min(max(BAND_MARGIN * highest, 1.5 * _lowest(omega, kept)), 0.45 * rate)
    kept &= np.abs(omega) < band
    damping = np.einsum("ij,ik,kj->j", shapes, linear.C, shapes)
    kept |= lags(omega, damping, band)  # damping couples them to what is seen
    kept &= np.cumsum(kept) <= MOST_MODES
    if not kept.any():
        raise BadCase(f"{case.path}: the recorded channels see no mode of the model below {0.45 * rate:.3g} Hz")
    basis = shapes[:, kept]
    stepped = _as_stepped(plant, linear, basis, min(plan_clock(plant.timestep, run).timestep for run in runs))
    structure, variant = case.structure, case.table.model.variant
    given = case.table.model.uncertain
    parameters: tuple[Uncertain, ...]
    if structure is None:
        parameters = tuple(uncertain_parameters(plant, given, names, driven))
        parts = parts_of(plant, parameters, basis)
    else:
        at_coils = plant.port_rows([coil.at for coil in structure.coil]) @ shapes
        among = np.cumsum(kept) - 1
        tuned = [int(among[j]) if kept[j] else -1 for j in driven_modes(at_coils)]
        last = max((k + 1 for k, j in enumerate(tuned) if j >= 0), default=0)
        parameters = tuple(structure_parameters(structure, given, names, driven, last))
        points = [p.name for p in structure.point if p.name in plant.ports]
        at_points = plant.port_rows(points) @ basis
        parts = structure_parts(structure, variant, parameters, at_points, omega[kept], points, tuned)
    pushes = np.hstack([actuator_forces(plant), plant.port_rows(load_ports).T.reshape(plant.model.nv, -1)])
    twin = Twin(
        omega=omega[kept],
        shapes=basis,
        M=basis.T @ linear.M @ basis + np.diag(stepped[0]),
        C=basis.T @ linear.C @ basis + np.diag(stepped[1]),
        K=basis.T @ linear.K @ basis + np.diag(stepped[2]),
        forces=basis.T @ pushes[:, : len(plant.actuators)],
        loads=basis.T @ pushes[:, len(plant.actuators) :],
        rows=rows.onto(basis),
        changes=changes_of(parameters),
        parts=parts,
    )
    hums = find_hum(runs)
    into = np.linalg.solve(twin.M, np.hstack([twin.forces, twin.loads]))
    stiff = ~kept & (np.abs(omega) >= band)
    still = (rows.at_q @ shapes[:, stiff] / omega[stiff] ** 2) @ shapes[:, stiff].T @ pushes
    still[:, : len(plant.actuators)] += command_readings(plant, channels)
    seen = Seen(direct=twin.rows.at_a @ into, still=still)
    signals = tuple(
        signals_of(
            _limited(plant, without_hum(run, hums)),
            plant,
            channels,
            rows.rest,
            load_ports,
            orders=orders,
            commands=recorded_commands(plant, run),
            highest_hz=highest,
            seen=seen,
        )
        for run in runs
    )
    places = tuple(places_of(plant, twin, names, driven))
    return Problem(
        case=case,
        plant=plant,
        twin=twin,
        parameters=parameters,
        channels=channels,
        names=names,
        runs=runs,
        orders=orders,
        about=np.where([c.from_rest for c in channels], 0.0, rows.rest),
        signals=signals,
        places=places,
        hums=hums,
        highest_hz=highest,
    )


def _as_stepped(plant: Plant, linear: SecondOrderModel, basis: Array, h: float) -> tuple[Array, Array, Array]:
    """Return what MuJoCo's step adds to the modes' mass, damping and stiffness.

    A semi-implicit step of length h raises frequencies by (omega h)^2/24, and dampers of joints, which it takes at its
    end, act as masses, too. Over a long lightly damped record that is no small thing, and it is no missing physics, so
    the twin has it as well: each mode gets the damping and stiffness of the eigenvalues of its own step. One beyond its critical
    damping, a servo's, gets them with its own stiffness, for it goes where it is told to, and so another mass.
    """
    model = plant.model
    c, k = (np.einsum("ij,ik,kj->j", basis, part, basis) for part in (linear.C, linear.K))
    if model.opt.integrator not in STAGGERED:
        return np.zeros_like(c), np.zeros_like(c), np.zeros_like(k)
    at_end = np.zeros_like(linear.C)
    if not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP):
        at_end[np.diag_indices(model.nv)] = model.dof_damping
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        at_end = linear.C if plant.dissipation is None else linear.C - plant.dissipation
    grown = 1.0 + h * np.einsum("ij,ik,kj->j", basis, at_end, basis)
    step = np.zeros((len(c), 2, 2))  # of velocity and displacement
    step[:, 0, 0], step[:, 0, 1] = 1.0 - h * c / grown, -h * k / grown
    step[:, 1, 0], step[:, 1, 1] = h * step[:, 0, 0], 1.0 + h * step[:, 0, 1]
    s = np.log(np.linalg.eigvals(step).astype(complex)) / h
    damping, stiffness = -s.sum(axis=1).real, s.prod(axis=1).real
    lagging = (0.25 * c**2 > k) & (k > FREE**2)
    mass = np.divide(k, stiffness, out=np.ones_like(k), where=lagging)
    return mass - 1.0, mass * damping - c, mass * stiffness - k


def _limited(plant: Plant, run: Run) -> Run:
    """Return a run whose driving channels are what the plant's own limits let through: the search is linear in them."""
    measured = run.measured
    data = measured.data.copy()
    for drive in run.drives:
        if drive.actuator is not None:
            i = measured.index(drive.channel)
            data[:, i] = within_limits(plant, drive.actuator, data[:, i])
    return run if np.array_equal(data, measured.data) else replace(run, measured=replace(measured, data=data))


def lags(omega: Array, damping: Array, band: float) -> Array:
    """Return which modes are damped beyond their critical damping, as a servo's are, with a slow pole that a band feels [rad/s].

    Parameters
    ----------
    omega, damping : (n,) array
        Frequencies [rad/s] and modal damping [1/s], of unit modal mass.
    """
    half = 0.5 * damping
    slow = omega**2 / np.maximum(half + np.sqrt(np.maximum(half**2 - omega**2, 0.0)), 1e-300)
    return np.asarray((half > np.abs(omega)) & (slow < LAGGING * band) & (np.abs(omega) > FREE))


def _lowest(omega: Array, kept: Array) -> float:
    moving = np.abs(omega[kept])
    moving = moving[moving > 1e-3]
    return float(moving.min() / (2 * np.pi)) if moving.size else 0.0


def recorded_commands(plant: Plant, run: Run) -> Array | None:
    """Return what the law in the loop commanded, (n_samples, n_actuators): recorded, or replayed on the recorded sensors."""
    if run.law is None:
        return None
    law: Law = replace(run.law, controller=copy.deepcopy(run.law.controller))
    out = np.zeros((len(run.measured), len(plant.actuators)))
    replayed = replayed_commands(run, law, run.measured, bench_for(plant, run))
    for column, actuator in enumerate(law.actuators):
        recorded = next((c for c in run.compared if c.actuator == actuator), None)
        commands = replayed[:, column] if recorded is None else run.measured[recorded.channel]
        out[:, actuator] = within_limits(plant, actuator, commands)
    return out


def changes_of(parameters: Sequence[Uncertain]) -> tuple[Change, ...]:
    """Return uncertain parameters as the twin has them."""
    return tuple(Change(name=p.name, sd=p.sd, actuator=p.actuator, sensor=p.sensor) for p in parameters)


def parts_of(plant: Plant, parameters: Sequence[Uncertain], basis: Array) -> tuple[Part, ...]:
    """Return what the uncertain parameters of an MJCF plant multiply, in modal coordinates.

    A spring's stiffness is one part, although a factor of its own and one of all springs multiply it: were both derivatives
    simply added, two factors of 7 % would leave the frequency of a light structure off by a tenth of its width.
    """
    by: dict[tuple[str, int], tuple[int, ...]] = {}
    for i, parameter in enumerate(parameters):
        for number in parameter.fields:
            by[number] = (*by.get(number, ()), i)
    together: dict[tuple[int, ...], list[tuple[str, int]]] = {}
    for number, multiplied in by.items():
        together.setdefault(multiplied, []).append(number)
    return tuple(_part(plant, tuple(fields), multiplied, basis) for multiplied, fields in together.items())


def _part(plant: Plant, fields: tuple[tuple[str, int], ...], by: tuple[int, ...], basis: Array) -> Part:
    one = Uncertain(name="", kind="", sd=1.0, fields=fields)

    def matrices(theta: float) -> tuple[Array, Array, Array]:
        linear = adjusted(plant, [one], np.array([theta])).linearise()
        return linear.M, linear.C, linear.K

    M, C, K = (basis.T @ part @ basis for part in derivative(matrices))
    return Part(
        by=by,
        M=M if np.abs(M).max() > 1e-9 else None,  # of modes with unit mass
        C=C if np.any(C) else None,
        K=K if np.any(K) else None,
    )
