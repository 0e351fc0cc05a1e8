"""Parameter sets of the twin marched through recordings side by side, with the laws at its ports in the loop.

The twin is linear and sampled exactly; a law's force is found from its port's motion at the middle of a step and held over it.
Laws that are linear in the motion and in what they remember are folded into the twin: their memory becomes states of it, found
by letting one step of the march act on unit vectors. What depends on time alone drives it. Only what is left, the nonlinear
laws, takes a loop over the samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vlab.diagnose.compiled import CHECKED, RUNAWAY, Loop
from vlab.diagnose.recursion import states_of
from vlab.diagnose.signals import LONG_PREROLL, PREROLL, Signals
from vlab.diagnose.terms import Term
from vlab.diagnose.twin import Discrete
from vlab.physics.effect import PortEffect, Step
from vlab.physics.tape import tape_of
from vlab.signals import Array

CHUNK = 400


def acting_order(terms: Sequence[Term]) -> list[int]:
    """Return the terms that are laws at ports in the order in which they act within a step.

    What does not depend on the motion comes first, then linear laws; dry friction is last, for sticking answers all other forces.
    """
    ports = [i for i, term in enumerate(terms) if isinstance(term.effect, PortEffect)]
    return sorted(ports, key=lambda i: _rank(terms[i].effect))


def _rank(effect: Any) -> int:
    return 3 if effect.family == "friction" else ("none", "linear", "any").index(effect.response)


@dataclass(eq=False)
class _Law:
    """A port's law in the march: what its force does to the states (n_sets, 1, 2m) and to what all ports see."""

    effect: PortEffect
    values: Mapping[str, Array]
    push: Array
    felt: Array
    mobility: Array
    coil: int | None
    memory: Any
    last: Array = field(default_factory=lambda: np.zeros(()))
    """What the force of the last step did to what the ports see."""


def march(
    system: Discrete,
    forces: Array,
    known: int,
    terms: Sequence[Term],
    values: Sequence[Mapping[str, Array]],
    ports: Sequence[int],
    starts: Array,
    runs: Sequence[Signals],
    substeps: int,
) -> Array:
    """March parameter sets through all samples.

    Parameters
    ----------
    system : Discrete
        Sampled at the substeps; its inputs are `known` ones, then the ports'.
    forces : (n, n_sets or 1, n_runs, known) array
    ports : sequence of int
        Which terms act at ports, see `acting_order`.
    starts : (n_sets, n_runs, 2m) array

    Returns
    -------
    (n, n_sets, n_runs, n_channels) array
        Channels.
    """
    n, n_sets, n_runs = len(forces), len(starts), starts.shape[1]
    BT, CT, DT = (np.swapaxes(part, 1, 2) for part in (system.B, system.C, system.D))
    seen = _seen_by([terms[i].place.rows[0] for i in ports], starts.shape[2] // 2)
    laws = [_law(terms[i], values[i], system.B[:, :, known + k], seen, k, runs, n_sets) for k, i in enumerate(ports)]
    marcher = _Marcher(system, laws, seen, runs, substeps)
    x, out = marcher.start(starts), np.zeros((n, n_sets, n_runs, system.C.shape[1]))
    for first in range(0, n, CHUNK):
        part = forces[first : first + CHUNK]
        drive = np.matmul(part, BT[:, :known])  # (chunk, n_sets, n_runs, 2m)
        states, pushed, x = marcher.through(drive, part, x, first)
        out[first : first + CHUNK] = np.matmul(states[..., : starts.shape[2]], CT)
        if np.any(DT):
            whole = np.concatenate([np.broadcast_to(part, (len(part), n_sets, n_runs, known)), pushed], axis=3)
            out[first : first + CHUNK] += np.matmul(whole, DT)
    return out


class _Marcher:
    """The twin with what can be folded into it, and the laws that are left.

    States are those of the twin, then what the linear laws remember. Everything acts on rows from the right.
    """

    def __init__(
        self, system: Discrete, laws: Sequence[_Law], seen: Array, runs: Sequence[Signals], substeps: int
    ) -> None:
        self.runs, self.substeps, self.h = runs, substeps, runs[0].h
        self.late = np.array([run.t0 for run in runs])
        self.laws, self.width = list(laws), system.A.shape[1]
        kinds = [law.effect.response for law in laws]
        self.is_looped = "any" in kinds
        self.given = [j for j, kind in enumerate(kinds) if kind == "none"]
        self.linear = [j for j, kind in enumerate(kinds) if kind == "linear"]
        self.left = [j for j in range(len(laws)) if j not in self.given and j not in self.linear]
        self.AT = np.ascontiguousarray(np.swapaxes(system.A, 1, 2))
        self.seen = seen
        self.answers: tuple[Array, Array] | None = None
        """What the linear laws' forces are of states and of drives."""
        self.DT: Array | None = None
        """What a drive does to the states; None where it is added to them."""
        if self.linear:
            self._fold()
        self.compiled = self._compiled() if self.is_looped else None
        if not self.is_looped:
            self._compose()

    def _fold(self) -> None:
        """Let a step with the linear laws act on unit vectors of states, memories and drives."""
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
        answers = np.stack(pushed, axis=-1)
        self.AT, self.DT = np.ascontiguousarray(whole[:, :size]), np.ascontiguousarray(whole[:, size:])
        self.answers = (answers[:, :size], answers[:, size:])
        self.seen = np.vstack([self.seen, np.zeros((size - m2, self.seen.shape[1]))])
        for law in self.laws:
            law.push = np.concatenate([law.push, np.zeros((*law.push.shape[:2], size - m2))], axis=-1)

    def _compose(self) -> None:
        """Find what a whole sample does to states, drives, and forces given at every substep."""
        step, into = self.AT, self.DT if self.DT is not None else np.eye(self.width)
        powers = [np.broadcast_to(into, (len(step), *into.shape[-2:]))]
        for _ in range(self.substeps - 1):
            powers.append(powers[-1] @ step)
        self.of_drive = np.sum(powers, axis=0)
        pushes = [self.laws[j].push[..., : self.width] for j in self.given]
        self.of_given = [[push @ powers[self.substeps - 1 - i] for i in range(self.substeps)] for push in pushes]
        self.over_sample = np.linalg.matrix_power(step, self.substeps)

    def start(self, starts: Array) -> Array:
        """Return the states that runs start from, (n_sets, n_runs, states)."""
        memories = [m[..., None] for j in self.linear for m in self.laws[j].memory]
        return np.concatenate([starts, *memories], axis=-1) if memories else starts.copy()

    def through(self, drive: Array, part: Array, x: Array, first: int) -> tuple[Array, Array, Array]:
        """Return the states at the samples of a chunk, the forces of the laws from them on, and the states at its end.

        Parameters
        ----------
        drive : (chunk, n_sets, n_runs, 2m) array
            What the known inputs `part` add to the states.
        first : int
            The chunk's first sample.
        """
        pushed = np.zeros((*drive.shape[:3], len(self.laws)))
        if self.is_looped:
            drives = self._with_given(drive, first, pushed)
            owns = drives if self.DT is None else [each @ self.DT for each in drives]
            states, x = self._looped(owns, part, x, first, pushed)
            drive = drives[0]
        else:
            own = drive @ self.of_drive if self.substeps > 1 or self.DT is not None else drive.copy()
            for j, ways in zip(self.given, self.of_given, strict=True):
                for i, way in enumerate(ways):
                    force = self._given(self.laws[j], len(drive), first, i)
                    own += force[..., None] * way
                    if i == 0:
                        pushed[..., j] = force
                        drive = drive + force[..., None] * self.laws[j].push[..., : self.width]
            states = states_of(self.over_sample, own, x)
            x = _contained(np.matmul(states[-1], self.over_sample) + own[-1])
        if self.answers is not None:
            pushed[..., self.linear] = states @ self.answers[0] + drive @ self.answers[1]
        return states, pushed, x

    def _with_given(self, drive: Array, first: int, pushed: Array) -> list[Array]:
        """Return drives with the forces that depend on time alone, one for every substep where there are any, and fill these in."""
        drives = [drive] * (self.substeps if self.given else 1)
        for j in self.given:
            forces = [self._given(self.laws[j], len(drive), first, i) for i in range(self.substeps)]
            push = self.laws[j].push[..., : drive.shape[-1]]
            drives = [each + force[..., None] * push for each, force in zip(drives, forces, strict=True)]
            pushed[..., j] = forces[0]
        return drives

    def _given(self, law: _Law, count: int, first: int, sub: int) -> Array:
        """Return a force that depends on time alone, (count, n_sets or 1, n_runs)."""
        t = (first + np.arange(count) + (sub + 0.5) / self.substeps)[:, None, None] * self.h + self.late
        zero = np.zeros(())
        force, _ = law.effect.force(zero, zero, law.values, Step(h=self.h / self.substeps, t=t), None)
        return np.broadcast_to(force, (count, len(self.AT), len(self.late)))

    def _force(self, law: _Law, j: int, at: Array, after: Array, now: Step, memory: Any) -> tuple[Array, Any]:
        """Return a law's force in a step from what its ports see before and after it, and its memory.

        What they see after the step is to hold the force itself, as well as it is known: a force of the velocity is otherwise
        late by half a step, which in a structure with damping ratios of a hundredth is no small damping.
        """
        middle, count = 0.5 * (at + after), len(self.laws)
        return law.effect.force(middle[..., j], middle[..., count + j], law.values, now, memory)

    def _looped(self, drives: Sequence[Array], part: Array, x: Array, first: int, pushed: Array) -> tuple[Array, Array]:
        """Return the states at the samples of a chunk and at its end; the forces of the laws in the loop are filled in.

        The laws see only their ports' motion, which goes along as so many more entries of the state. Drives are those of
        the substeps, or of all of them.
        """
        step_of = np.concatenate([self.AT, self.AT @ self.seen], axis=-1)
        driven = np.stack([np.concatenate([each, each @ self.seen], axis=-1) for each in drives])
        if self.compiled is None:
            return self._written(step_of, driven, part, x, first, pushed)
        step = self.h / self.substeps
        states, forces, x = self.compiled.through(step_of, self.seen, driven, part, x, first, step, self.substeps)
        pushed[..., self.left] = forces
        return states, x

    def _compiled(self) -> Loop | None:
        """Return the laws in the loop as tapes; None where one cannot be played from a tape."""
        laws = [self.laws[j] for j in self.left]
        tapes = [tape_of(law.effect, self.h / self.substeps) for law in laws]
        if not all(tapes):
            return None
        return Loop(
            tapes=[tape for tape in tapes if tape is not None],
            values=[[law.values[p.name] for p in law.effect.parameters] for law in laws],
            memories=[law.memory or () for law in laws],
            push=np.stack([law.push[:, 0] for law in laws]),
            felt=np.stack([law.felt[:, 0] for law in laws]),
            ports=self.left,
            coils=[-1 if law.coil is None else law.coil for law in laws],
            late=self.late,
        )

    def _written(
        self, step_of: Array, driven: Array, part: Array, x: Array, first: int, pushed: Array
    ) -> tuple[Array, Array]:
        """As `_looped`, the laws evaluated as they are written: some do what no tape can hold."""
        step, laws = self.h / self.substeps, [(j, self.laws[j]) for j in self.left]
        count, width = len(self.laws), x.shape[-1]
        both = {j: np.concatenate([law.push, law.felt], axis=-1) for j, law in laws}
        states = np.zeros((*driven[0].shape[:1], *x.shape))
        state = np.concatenate([x, x @ self.seen], axis=-1)
        last = {j: law.last for j, law in laws}
        for k in range(len(part)):
            states[k] = state[..., :width]
            for sub in range(self.substeps):
                new = np.matmul(state[..., :width], step_of)
                new += driven[sub % len(driven)][k]
                at, after = state[..., width:], new[..., width:]
                t = self.late + ((first + k) * self.h + (sub + 0.5) * step)
                # forces change by little in a step: the last ones stand for those not known yet
                own = sum(last.values())
                for j, law in laws:
                    now = Step(
                        h=step,
                        t=t,
                        mobility=law.mobility,
                        free_velocity=after[..., count + j],
                        first_velocity=at[..., count + j],
                        command=0.0 if law.coil is None else part[k][..., law.coil],
                    )
                    force, law.memory = self._force(law, j, at, after + own, now, law.memory)
                    change = force[..., None] * both[j]
                    if len(laws) > 1:
                        own = own - last[j]
                    last[j] = change[..., width:]
                    new += change
                    if sub == 0:
                        pushed[k, ..., j] = force
                state = new
            if k % CHECKED == 0:
                own_states = state[..., :width]
                contained = _contained(own_states)
                if contained is not own_states:
                    state = np.concatenate([contained, contained @ self.seen], axis=-1)
                    last = {j: np.zeros(()) for j, _ in laws}
        for j, law in laws:
            law.last = last[j]
        return states, state[..., :width]


def _seen_by(rows: Sequence[Array], m: int) -> Array:
    """Return what makes displacements, then velocities, of ports of states, (2m, 2 n_ports)."""
    out = np.zeros((2 * m, 2 * len(rows)))
    for j, row in enumerate(rows):
        out[:m, j], out[m:, len(rows) + j] = row, row
    return out


def _law(
    term: Term, values: Mapping[str, Array], push: Array, seen: Array, k: int, runs: Sequence[Signals], n_sets: int
) -> _Law:
    assert isinstance(term.effect, PortEffect)
    p = {name: np.asarray(v)[:, None] for name, v in values.items()}
    felt = push @ seen
    return _Law(
        effect=term.effect,
        values=p,
        push=push[:, None, :],
        felt=felt[:, None, :],
        mobility=felt[:, seen.shape[1] // 2 + k][:, None],
        coil=term.place.coil,
        memory=_remember(term.effect, term.place.rows[0], p, runs, n_sets),
    )


def _remember(effect: PortEffect, row: Array, p: Mapping[str, Array], runs: Sequence[Signals], n_sets: int) -> Any:
    """Return a law's memory after the smoothed motion that stands before every window."""
    memory = effect.memory((n_sets, len(runs)))
    is_linear = effect.response == "linear"
    most = LONG_PREROLL if is_linear else PREROLL
    longest = min(max((0 if run.before is None else len(run.before)) for run in runs), most)
    if memory is None or longest == 0:
        return memory
    m = len(row)
    motion = np.zeros((longest, 2, len(runs)))  # displacement and velocity, in the middle of each step
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
    """Return what a linear law remembers of motion (n, 2, n_runs), each entry (n_sets, n_runs): a sum over decaying modes."""
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


def _contained(x: Array) -> Array:
    """Return states, brought back to large numbers where they ran away."""
    if np.abs(x).max() < RUNAWAY:
        return x
    return np.clip(np.nan_to_num(x, nan=1e9, posinf=1e9, neginf=-1e9), -1e9, 1e9)
