"""Time integration of reduced models with port laws.

The linear model is discretised exactly. A law's force follows from the port motion in the middle of a step and is held
over the step. Laws linear in motion and memory become additional states, by one step on unit vectors. Laws of time
alone are inputs. Only nonlinear laws need a loop over the samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlab.diagnose.data.runs import Signals
from vlab.diagnose.parameters.discrete import Discrete
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_integration import LoopLaw, Marched, integrate_modes
from vlab.diagnose.predictors.residual_flexibility import StartLaw
from vlab.diagnose.settings import KERNELS, RUNS
from vlab.physics.effect import PortEffect, Step
from vlab.physics.expression import trace_expression
from vlab.signals import Array


def acting_order(terms: Sequence[Term]) -> list[int]:
    """Return the port laws in their order of evaluation.

    Laws of time come first, then linear laws; dry friction is last, since sticking balances all other forces.

    Parameters
    ----------
    terms : sequence of Term
        Effects.

    Returns
    -------
    list of int
        Indices of the port laws.
    """
    ports = [i for i, term in enumerate(terms) if term.effect.is_force]
    return sorted(ports, key=lambda i: _rank(terms[i].effect))


def _rank(effect: Any) -> int:
    return 3 if effect.traits.is_dry_friction else ("none", "linear", "any").index(effect.response)


@dataclass(eq=False)
class _Law:
    """Port law with the response to its force."""

    effect: PortEffect
    values: Mapping[str, Array]
    push: Array
    felt: Array
    direct: Array
    effort: Array | None
    seen: float
    mobility: Array
    coil: int | None
    memory: Any


def integrate(
    system: Discrete,
    forces: Array,
    known: int,
    terms: Sequence[Term],
    values: Sequence[Mapping[str, Array]],
    ports: tuple[Sequence[int], Sequence[Array]],
    starts: Array,
    runs: Sequence[Signals],
    substeps: int,
) -> Array:
    """Integrate parameter sets through all samples.

    Parameters
    ----------
    system : Discrete
        System discretised at the substeps; inputs are `known` ones, then the ports.
    forces : (n, n_sets or 1, n_runs, known) array
        Known inputs.
    known : int
        Number of known inputs.
    terms : sequence of Term
        Effects.
    values : sequence of mapping
        Parameter values (n_sets,) of every term.
    ports : tuple of sequence
        Port laws in the order of `acting_order`, and their rows (m,).
    starts : (n_sets, n_runs, 2m) array
        Initial states.
    runs : sequence of Signals
        Runs.
    substeps : int
        Integration steps per sample.

    Returns
    -------
    (n, n_sets, n_runs, n_channels) array
        Channels.
    """
    seen, n_sets = _seen_by(ports[1], starts.shape[2] // 2), len(starts)
    laws = [_law(terms[i], values[i], system, known + k, seen, k, runs, n_sets) for k, i in enumerate(ports[0])]
    return _Marcher(system, laws, seen, runs, substeps).through(forces, starts)


class _Marcher:
    """Linear system with folded linear laws, and the remaining laws.

    States are those of the reduced model, then the memory of linear laws. Matrices act on rows from the right.
    """

    def __init__(
        self, system: Discrete, laws: Sequence[_Law], seen: Array, runs: Sequence[Signals], substeps: int
    ) -> None:
        self.runs, self.substeps, self.h = runs, substeps, runs[0].h
        self.late = np.array([run.t0 for run in runs])
        self.laws, self.width = list(laws), system.A.shape[1]
        kinds = [law.effect.response for law in laws]
        self.given = [j for j, kind in enumerate(kinds) if kind == "none"]
        self.linear = [j for j, kind in enumerate(kinds) if kind == "linear" and laws[j].effort is None]
        self.left = [j for j in range(len(laws)) if j not in self.given and j not in self.linear]
        self.AT, BT, self.CT, DT = (np.swapaxes(x, 1, 2) for x in (system.A, system.B, system.C, system.D))
        inputs = [*range(BT.shape[1] - len(laws)), *(BT.shape[1] - len(laws) + j for j in self.given)]
        self.into, self.direct, self.seen = BT[:, inputs], DT[:, inputs], seen
        if self.linear:
            self._fold()

    def _fold(self) -> None:
        """Fold the linear laws into the linear system."""
        laws = [self.laws[j] for j in self.linear]
        counts = [len(law.memory) for law in laws]
        n_sets, m2, size = len(self.AT), self.width, self.width + sum(counts)
        unit = np.broadcast_to(np.eye(size + m2), (n_sets, size + m2, size + m2))
        at, x = unit[..., :m2] @ self.seen, unit[..., :m2] @ self.AT + unit[..., size:]
        after, memories, pushed, start = x @ self.seen, [], [], m2
        for law, j, count in zip(laws, self.linear, counts, strict=True):
            memory = [unit[..., start + i] for i in range(count)]
            start += count
            now = Step(h=self.h / self.substeps)
            first, _ = self._force(law, j, at, after, now, memory)
            force, memory = self._force(law, j, at, after + first[..., None] * law.felt, now, memory)
            x, after = x + force[..., None] * law.push, after + force[..., None] * law.felt
            memories += memory
            pushed.append(force)
        whole = np.concatenate([x, np.stack(memories, axis=-1)], axis=-1)
        of_states, of_drives = np.split(np.stack(pushed, axis=-1), [size], axis=1)
        at_once = np.stack([law.direct for law in laws], axis=1)
        self.direct = self.direct + self.into @ of_drives @ at_once
        self.CT = np.concatenate([self.CT, np.zeros((n_sets, size - m2, self.CT.shape[2]))], axis=1)
        self.CT = self.CT + of_states @ at_once
        self.AT, self.into = whole[:, :size], self.into @ whole[:, size:]
        self.seen = np.vstack([self.seen, np.zeros((size - m2, self.seen.shape[1]))])
        for law in self.laws:
            law.push = np.concatenate([law.push, np.zeros((*law.push.shape[:2], size - m2))], axis=-1)

    def through(self, forces: Array, starts: Array) -> Array:
        """Return the channels through all samples."""
        memories = [m[..., None] for j in self.linear for m in self.laws[j].memory]
        x = np.concatenate([starts, *memories], axis=-1)
        h = self.h / self.substeps
        graphs = [trace_expression(self.laws[j].effect, h) for j in self.left]
        if not all(graphs):
            return self._as_written(forces, x)
        acts = np.any(forces, axis=(0, 1, 2))  # a bench has inputs that no recording uses
        coils = [law.coil for j in self.left if (law := self.laws[j]).coil is not None]
        acts |= np.isin(np.arange(len(acts)), coils)
        given = self._given(0, len(forces))
        inputs = np.flatnonzero(np.concatenate([acts, np.ones(given.shape[-1], dtype=bool)]))
        laws = [
            LoopLaw(
                graph=graph,
                values=[law.values[p.name] for p in law.effect.parameters],
                memory=law.memory or (),
                push=law.push[:, 0],
                direct=law.direct,
                effort=law.effort,
                seen=law.seen,
                port=j,
                coil=None if law.coil is None else int(np.count_nonzero(acts[: law.coil])),
            )
            for j, graph in zip(self.left, graphs, strict=True)
            if graph is not None and (law := self.laws[j])
        ]
        system = Marched(
            step=self.AT, into=self.into[:, inputs], channels=self.CT, direct=self.direct[:, inputs], seen=self.seen
        )
        return integrate_modes(system, laws, forces[..., acts], given, x, self.late, h)

    def _given(self, first: int, count: int) -> Array:
        """Return the forces of time alone, (count, substeps, n_sets, n_runs, n_given)."""
        out = np.empty((count, self.substeps, len(self.AT), len(self.late), len(self.given)))
        middles = np.arange(count)[:, None] + (np.arange(self.substeps) + 0.5) / self.substeps
        t, zero = (first + middles)[..., None, None] * self.h + self.late, np.zeros(())
        for i, j in enumerate(self.given):
            law = self.laws[j]
            out[..., i], _ = law.effect.force(zero, zero, law.values, Step(h=self.h / self.substeps, t=t), None)
        return out

    def _force(self, law: _Law, j: int, at: Array, after: Array, now: Step, memory: Any) -> tuple[Array, Any]:
        """Return a law's force in a step, and its memory.

        The motion after the step includes the force itself as far as known. Otherwise a velocity force would lag half a
        step, which changes damping at ratios of a hundredth.
        """
        middle, count = 0.5 * (at + after), len(self.laws)
        return law.effect.force(middle[..., j], middle[..., count + j], law.values, now, memory)

    def _as_written(self, forces: Array, x: Array) -> Array:
        """Integrate with laws without an expression graph."""
        n, step, laws = len(forces), self.h / self.substeps, [(j, self.laws[j]) for j in self.left]
        count, width = len(self.laws), x.shape[-1]
        into = np.concatenate([self.into, self.into @ self.seen], axis=-1)
        step_of = np.concatenate([self.AT, self.AT @ self.seen], axis=-1)
        both = {j: np.concatenate([law.push, law.felt], axis=-1) for j, law in laws}
        known = forces.shape[3]
        out = np.zeros((n, *x.shape[:2], self.CT.shape[2]))
        state, last = np.concatenate([x, x @ self.seen], axis=-1), {j: np.zeros(()) for j, _ in laws}
        read = np.zeros(out.shape[1:])
        for k in range(n):
            given = self._given(k, 1)[0]
            out[k] = (
                state[..., :width] @ self.CT + forces[k] @ self.direct[:, :known] + given[0] @ self.direct[:, known:]
            )
            out[k] += read
            read = np.zeros(out.shape[1:])
            for sub in range(self.substeps):
                new = state[..., :width] @ step_of + forces[k] @ into[:, :known] + given[sub] @ into[:, known:]
                at, after = state[..., width:], new[..., width:]
                t = self.late + (k * self.h + (sub + 0.5) * step)
                own = sum(last.values())  # as in the compiled loop
                for j, law in laws:
                    now = Step(
                        h=step,
                        t=t,
                        mobility=law.mobility,
                        free_velocity=after[..., count + j],
                        first_velocity=at[..., count + j],
                        command=0.0 if law.coil is None else forces[k][..., law.coil],
                    )
                    force, law.memory = self._force(law, j, at, after + own, now, law.memory)
                    change = force[..., None] * both[j]
                    own = own - last[j]
                    last[j] = change[..., width:]
                    new += change
                    if sub == 0:
                        out[k] += force[..., None] * law.direct[:, None, :]
                    if law.effort is not None:  # as in the compiled loop
                        first, past = (_to_the_end(i, self.substeps) for i in (sub, self.substeps - 1 - sub))
                        out[k] += first * (1.0 if k == 0 else law.seen) * force[..., None] * law.effort
                        read += past * (1.0 - law.seen) * force[..., None] * law.effort
                state = new
            if k % KERNELS.checked == 0 and not np.abs(state[..., :width]).max() < KERNELS.runaway:
                x = np.clip(
                    np.nan_to_num(state[..., :width], nan=KERNELS.most, posinf=KERNELS.most, neginf=-KERNELS.most),
                    -KERNELS.most,
                    KERNELS.most,
                )
                state, last = np.concatenate([x, x @ self.seen], axis=-1), {j: np.zeros(()) for j, _ in laws}
        return out


def _to_the_end(steps: int, substeps: int) -> float:
    """Return the weight of a substep in an extrapolation.

    The extrapolation goes to an end of the interval. `steps` counts from there.
    """
    return 1.0 if substeps == 1 else {0: 1.5, 1: -0.5}.get(steps, 0.0)


def _seen_by(rows: Sequence[Array], m: int) -> Array:
    """Return the map from states to port motion."""
    out = np.zeros((2 * m, 2 * len(rows)))
    for j, row in enumerate(rows):
        out[:m, j], out[m:, len(rows) + j] = row, row
    return out


def _law(
    term: Term,
    values: Mapping[str, Array],
    system: Discrete,
    column: int,
    seen: Array,
    k: int,
    runs: Sequence[Signals],
    n_sets: int,
) -> _Law:
    assert isinstance(term.effect, PortEffect)
    p = {name: np.asarray(v)[:, None] for name, v in values.items()}
    push = system.B[:, :, column]
    felt = push @ seen
    return _Law(
        effect=term.effect,
        values=p,
        push=push[:, None, :],
        felt=felt[:, None, :],
        direct=system.D[:, :, column],
        effort=term.place.effort_in_drive if term.effect.acts_in_drive else None,
        seen=term.place.seen,
        mobility=felt[:, seen.shape[1] // 2 + k][:, None],
        coil=term.place.coil,
        memory=_remember(term.effect, term.place.rows[0], p, runs, n_sets),
    )


def law_at_start(term: Term, values: Mapping[str, Array], runs: Sequence[Signals], n_sets: int) -> StartLaw:
    """Return a law's force over port motion at the starts of runs.

    Parameters
    ----------
    term : Term
        Port law.
    values : mapping
        Parameter values (n_sets,).
    runs : sequence of Signals
        Runs.
    n_sets : int
        Number of parameter sets.

    Returns
    -------
    StartLaw
        Force.
    """
    assert isinstance(term.effect, PortEffect)
    effect, p = term.effect, {name: np.asarray(v)[:, None] for name, v in values.items()}
    memory = _remember(effect, term.place.rows[0], p, runs, n_sets)
    now = Step(h=runs[0].h, t=np.array([run.t0 for run in runs]))

    def force(z: Array, v: Array) -> Array:
        with np.errstate(all="ignore"):  # a diverged trial
            return np.broadcast_to(effect.force(z, v, p, now, memory)[0], z.shape)

    return force


def _remember(effect: PortEffect, row: Array, p: Mapping[str, Array], runs: Sequence[Signals], n_sets: int) -> Any:
    """Return a law's memory at every window's start."""
    memory = effect.memory((n_sets, len(runs)))
    is_linear = effect.response == "linear"
    most = RUNS.long_preroll if is_linear else RUNS.preroll
    longest = min(max((0 if run.before is None else len(run.before)) for run in runs), most)
    if memory is None or longest == 0:
        return memory
    m = len(row)
    motion = np.zeros((longest, 2, len(runs)))  # displacement and velocity in the middle of each step
    for i, run in enumerate(runs):
        if run.before is None or not len(run.before):
            continue
        x = np.vstack([run.before[-longest:], run.before[-1] if run.start is None else run.start])
        seen = np.stack([x[:, :m] @ row, x[:, m:] @ row], axis=1)
        motion[-len(x) + 1 :, :, i] = 0.5 * (seen[1:] + seen[:-1])
    now = Step(h=runs[0].h)
    if is_linear:
        return _remembered(effect, p, motion, now, n_sets)
    for z, v in motion:
        memory = effect.force(z[None], v[None], p, now, memory)[1]
    return memory


def _remembered(effect: PortEffect, p: Mapping[str, Array], motion: Array, now: Step, n_sets: int) -> list[Array]:
    """Return a linear law's memory after a given motion."""
    still, count = np.zeros((n_sets, 1)), len(effect.memory((n_sets, 1)) or ())

    def after(z: Array, v: Array, memory: list[Array]) -> Array:
        return np.stack([part[:, 0] for part in effect.force(z, v, p, now, memory)[1]], axis=1)

    none, one = [still] * count, np.ones((n_sets, 1))
    A = np.stack([after(still, still, [*none[:i], one, *none[i + 1 :]]) for i in range(count)], axis=2)
    B = np.stack([after(one, still, none), after(still, one, none)], axis=2)
    decay, modes = np.linalg.eig(A)
    weights = decay[..., None] ** np.arange(len(motion) - 1, -1, -1)
    driven = np.einsum("scd,scl,ldr->scr", np.linalg.solve(modes, B), weights, motion, optimize=True)
    return [np.ascontiguousarray(part) for part in np.moveaxis((modes @ driven).real, 1, 0)]
