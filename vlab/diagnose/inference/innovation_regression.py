"""Linear regression of innovations on uncertain parameters and effects, with Gaussian priors.

N are the columns of the uncertain parameters, and P is their prior covariance. Innovations e of unit variance have the
covariance I + N P N^T. Its inverse W weighs the columns c of an effect. The log-likelihood gain of the effect is
b^T A^-1 b/2 with A = c^T W c and b = c^T W e (Rao 1948, see `vlab.diagnose.inference.score_test`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.settings import SCORE_TEST
from vlab.physics.effect import Effect, SensorEffect
from vlab.signals import Array


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Whitened columns of effects and shapes at a location.

    Parameters
    ----------
    effects : list of (Effect, dict)
        Effects with the values of their shape parameters.
    widths : list of int
        Number of columns of every effect.
    rows : (rows, sum of widths) array
        Columns.
    """

    effects: list[tuple[Effect, dict[str, float]]]
    widths: list[int]
    rows: Array

    def of(self, effect: Effect, shape: dict[str, float]) -> Array | None:
        """Return the columns of an effect.

        Parameters
        ----------
        effect : Effect
            Effect.
        shape : dict
            Values of the shape parameters.

        Returns
        -------
        (rows, k) array or None
            Columns; None where they are not known.
        """
        start = 0
        for (other, values), width in zip(self.effects, self.widths, strict=True):
            if other.name == effect.name and values == shape:
                return self.rows[:, start : start + width].astype(float)
            start += width
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class Regression:
    """Regression of innovations on nuisance columns.

    Parameters
    ----------
    e : (rows,) array
        Whitened innovations.
    nuisance : (rows, k) array
        Columns of uncertain parameters and offsets, and of effects taken as present.
    precision : (k,) array
        Inverse prior variances of the coefficients.
    pull : (k,) array
        Precision times the present values, whose prior mean is zero.
    gram : (k, k) array
        Inverse of the normal matrix.
    solution : (k,) array
        Coefficients.
    base : (rows,) array
        Residual.
    variance : float
        Mean square of the residual [1].
    """

    e: Array
    nuisance: Array
    precision: Array
    pull: Array
    gram: Array
    solution: Array
    base: Array
    variance: float

    @classmethod
    def of(
        cls, e: Array, nuisance: Array, precision: Array, pull: Array, inverse: Callable[[Array], Array]
    ) -> "Regression":
        """Return the regression of innovations.

        Parameters
        ----------
        e : (rows,) array
            Whitened innovations.
        nuisance : (rows, k) array
            Columns.
        precision, pull : (k,) array
            Inverse prior variances, and their product with the present values.
        inverse : callable
            Inverse of the normal matrix.

        Returns
        -------
        Regression
            Regression at full weight of all samples.
        """
        gram = inverse(nuisance.T @ nuisance + np.diag(precision))
        solution = gram @ (nuisance.T @ e - pull)
        base = e - nuisance @ solution
        return cls(
            e=e,
            nuisance=nuisance,
            precision=precision,
            pull=pull,
            gram=gram,
            solution=solution,
            base=base,
            variance=max(float(np.mean(base**2)), np.finfo(float).tiny),  # no innovation at all
        )

    def beside(self, columns: Sequence[Array]) -> "Regression":
        """Return the regression with free amplitudes of effects taken as present.

        Parameters
        ----------
        columns : sequence of (rows, k) array
            Whitened columns of the effects.

        Returns
        -------
        Regression
            Regression with the columns after the others; the same without columns.
        """
        if not columns:
            return self
        nuisance = np.hstack([self.nuisance, *columns])
        more = nuisance.shape[1] - self.nuisance.shape[1]
        precision, pull = np.pad(self.precision, (0, more), constant_values=1e-12), np.pad(self.pull, (0, more))
        return Regression.of(self.e, nuisance, precision, pull, scaled_inverse)

    def cautious(self) -> Array:
        """Return the coefficients (k,) at a small effective sample size.

        The innovations' model error does not average out over samples. Full weight would let weakly identified
        directions drift many standard deviations.
        """
        share = SCORE_TEST.model_error_samples / len(self.e) / max(self.variance, 1.0)
        normal = share * self.nuisance.T @ self.nuisance + np.diag(self.precision)
        return np.asarray(scaled_inverse(normal) @ (share * (self.nuisance.T @ self.e) - self.pull))

    def normal_matrix(self, columns: Array, along: Array) -> Array:
        """Return the normal matrix of columns beside the nuisance columns.

        Parameters
        ----------
        columns : (rows, k) array
            Columns.
        along : (nuisances, k) array
            Their products with the nuisance columns.

        Returns
        -------
        (k, k) array
            Normal matrix.
        """
        return np.asarray(columns.T @ columns - along.T @ (self.gram @ along))

    def gain(self, normal: Array, pull: Array, effect: Effect) -> tuple[float, Array]:
        """Return the gain of an effect's columns, and their coefficients.

        Parameters
        ----------
        normal : (k, k) array
            Normal matrix of the columns, by `normal_matrix`.
        pull : (k,) array
            Products of the columns with `base`.
        effect : Effect
            Effect with the signs of its amplitudes.

        Returns
        -------
        gain : float
            Log-likelihood gain [nat].
        coefficients : (k,) array
            Amplitudes.
        """
        size = np.sqrt(np.diag(normal).clip(0.0))
        width = len(size)
        if not np.all(size > 1e-9):
            return 0.0, np.zeros(width)
        gram = normal / np.outer(size, size) + 1e-9 * np.eye(width)
        b = pull / size
        x = np.linalg.solve(gram, b)
        negative = [i for i, p in enumerate(effect.amplitudes) if not p.signed and x[i] < 0]
        if negative:  # a negative friction or mass counts as its standard deviation
            others = [i for i in range(width) if i not in negative]
            x = np.full(width, np.sqrt(self.variance))
            if others:
                x[others] = np.linalg.solve(gram[np.ix_(others, others)], b[others])
            if not others or any(x[i] < 0 for i, p in enumerate(effect.amplitudes) if not p.signed):
                return 0.0, np.sqrt(self.variance) / size
            return 0.5 * float(b[others] @ x[others]) / self.variance, x / size
        if not effect.amplitudes and x[0] < SCORE_TEST.least_projection * size[0]:
            return 0.0, np.zeros(width)
        return 0.5 * float(b @ x) / self.variance, x / size

    def gain_of_correction(
        self, normal: float, pull: float, effect: SensorEffect, values: dict[str, float], h: float, channels: int
    ) -> float:
        """Return the log-likelihood gain of a corrected recording.

        The correction's amplification of noise is subtracted.

        Parameters
        ----------
        normal, pull : float
            Normal matrix of the correction's column, and the column's product with `base`.
        effect : SensorEffect
            Effect without amplitudes.
        values : dict
            Values of the shape parameters.
        h : float
            Sample period [s].
        channels : int
            Number of channels.

        Returns
        -------
        float
            Log-likelihood gain [nat].
        """
        # least sum of squares and priors; always positive, unlike base @ e beside present values off the prior means
        off = self.solution + self.pull / self.precision
        before = float(self.base @ self.base + off @ (self.precision * off))
        after = before - 2 * pull + normal
        if not after > 0:
            return 0.0
        samples = len(self.e) / channels
        return 0.5 * len(self.e) * float(np.log(before / after)) + samples * effect.stretch(values, h)


def candidates_of(
    columns: EffectColumns, place: Place, regression: Regression, h: float, channels: int
) -> list[Candidate]:
    """Return the candidates of columns.

    Parameters
    ----------
    columns : EffectColumns
        Columns of effects and shapes.
    place : Place
        Location.
    regression : Regression
        Regression on the nuisance columns.
    h : float
        Sample period [s].
    channels : int
        Number of channels.

    Returns
    -------
    list of Candidate
        Candidates with amplitudes and log-likelihood gains, in the order of the columns.
    """
    rows = np.asarray(columns.rows, dtype=float)
    along, pull = regression.nuisance.T @ rows, regression.base @ rows
    out: list[Candidate] = []
    start = 0
    for (effect, values), width in zip(columns.effects, columns.widths, strict=True):
        part = slice(start, start + width)
        normal = regression.normal_matrix(rows[:, part], along[:, part])
        if isinstance(effect, SensorEffect) and not effect.amplitudes:
            gain = regression.gain_of_correction(float(normal[0, 0]), float(pull[start]), effect, values, h, channels)
            amplitudes = np.zeros(0)
        else:
            gain, amplitudes = regression.gain(normal, pull[part], effect)
        start += width
        names = [p.name for p in effect.amplitudes]
        found = {**values, **dict(zip(names, amplitudes.tolist(), strict=False))} if names else dict(values)
        out.append(Candidate(effect=effect, place=place, values=found, log_likelihood_gain=gain))
    return out


def joint_estimate(
    theta: Array, offsets: int, candidates: Sequence[Candidate], solution: Array
) -> tuple[Array, list[dict[str, float]]]:
    """Return the joint estimate of uncertain parameters and candidates.

    Parameters
    ----------
    theta : (n_changes,) array
        Present log factors of the uncertain parameters.
    offsets : int
        Number of sensor offsets.
    candidates : sequence of Candidate
        Candidates taken as present.
    solution : (k,) array
        Coefficients of uncertain parameters, offsets and candidates.

    Returns
    -------
    theta : (n_changes,) array
        Log factors.
    values : list of dict
        Parameter values of every candidate.
    """
    at, values = len(theta) + offsets, []
    estimate = np.clip(theta + solution[: len(theta)], -SCORE_TEST.most_theta, SCORE_TEST.most_theta)
    for candidate in candidates:
        own = dict(candidate.values)
        for parameter in candidate.effect.amplitudes:
            found = float(solution[at])
            own[parameter.name] = (
                found if parameter.signed else max(found, SCORE_TEST.least_amplitude * abs(own[parameter.name]), 1e-300)
            )
            at += 1
        values.append(own)
        at += not candidate.effect.amplitudes
    return estimate, values


def scaled_inverse(normal: Array) -> Array:
    """Return the scaled pseudo-inverse of a normal matrix (k, k)."""
    size = np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.pinv(normal / np.outer(size, size), hermitian=True) / np.outer(size, size))
