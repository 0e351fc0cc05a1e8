"""Sparse regression on measured states by pysindy, as in SINDy [1]_.

The weak form is that of [2]_, ensembles are those of [3]_.

Every acceleration is a sparse sum of a constant, the states, the inputs and memoryless laws of the catalogue at every
joint and tendon. Columns and accelerations are divided by their rms, so a threshold is a share of an acceleration.

Tuning by cross-validation over the fit recordings: each is left out in turn, and the identified equations run freely over
it under its inputs. The grid is the product of `FORMS`, `LIBRARIES` and `THRESHOLDS`. Of all settings within `AS_GOOD` of
the least error the one with fewest nonlinear terms is taken. Thresholded least squares on `MODELS` bootstrap samples of
all fit recordings then give the median coefficients. The named effect is the nonlinear term with the largest share of an
acceleration's rms.

References
----------
.. [1] S. L. Brunton, J. L. Proctor, J. N. Kutz, "Discovering governing equations from data by sparse identification of
   nonlinear dynamical systems", *PNAS* 113 (2016) 3932-3937.
.. [2] D. A. Messenger, D. M. Bortz, "Weak SINDy: Galerkin-based data-driven model selection", *Multiscale Model. Simul.*
   19 (2021) 1474-1497.
.. [3] U. Fasel, J. N. Kutz, B. W. Brunton, S. L. Brunton, "Ensemble-SINDy", *Proc. R. Soc. A* 478 (2022) 20210904.
"""

import importlib.util
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.proof.peers.measured_states import States, joint_channels, states_of
from vlab.proof.peers.result import Named, NotUsable, PeerResult, compared_names, error_of, mean_error, mjcf_runs
from vlab.proof.peers.sparse_columns import SMOOTH, Columns, Library, free_runs
from vlab.signals import Array

HAS_PYSINDY = importlib.util.find_spec("pysindy") is not None
"""HAS_PYSINDY: whether pysindy is installed."""
THRESHOLDS = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2)
"""THRESHOLDS [-]: shares of an acceleration's rms below which a term is dropped."""
RIDGE = 1e-6
"""RIDGE [-]: ridge penalty of the least squares per row, on columns of unit rms."""
AS_GOOD = 1.05
"""AS_GOOD [-]: ratio of free-run errors up to which the simpler setting is taken."""
MODELS = 20
"""MODELS [-]: bootstrap samples of the final regression."""
DOMAINS, DEGREE = 400, 4
"""DOMAINS [-]: test functions of the weak form per recording, at random times.
DEGREE [-]: degree p of the test functions (1 - s^2)^p."""
SEED = 20
"""SEED [-]: seed of test functions and bootstrap samples."""
THINNED = 3
"""THINNED [samples]: spacing of the rows of the regression on derivatives, which are correlated over a window."""


@dataclass(frozen=True, kw_only=True)
class Form:
    """Form of the regression.

    Parameters
    ----------
    window_s : float
        Window of the local polynomials that give the states [s].
    half_s : float
        Half the length of a test function of the weak form [s]; 0 for the derivatives of the local polynomials.
    """

    window_s: float
    half_s: float = 0.0


FORMS = (
    Form(window_s=0.012),
    Form(window_s=0.03),
    Form(window_s=0.012, half_s=0.05),
    Form(window_s=0.012, half_s=0.1),
    Form(window_s=0.03, half_s=0.1),
)
"""FORMS: tried forms, for motion up to 30 Hz."""
LIBRARIES = (
    Library(),
    Library(rise=0.05),
    Library(rise=0.3),
    Library(rise=0.05, below=0.3, above=0.3, clearance="dead-band"),
    Library(rise=0.05, below=1.0, above=1.0, clearance="stop"),
    Library(rise=0.05, below=1.8, above=1.8, clearance="stop"),
    Library(rise=0.05, above=0.0, clearance="one-sided-stiffness"),
)
"""LIBRARIES: tried libraries: linear, two widths of friction, clearances with scanned gaps."""
NAMES = (*SMOOTH, "dead-band", "stop", "one-sided-stiffness")
"""NAMES: effects that the peer can name."""


def sparse_regression(case: Case) -> PeerResult:
    """Identify the equations of motion of a case.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    PeerResult
        Strongest nonlinear term, and the error of free runs over the hold-out recordings.

    Raises
    ------
    NotUsable
        pysindy is missing, or the states are not all measured.
    """
    if not HAS_PYSINDY:
        raise NotUsable("needs pysindy; pip install 'vlab-vibration[peers]'")
    plant, fit, holdout = mjcf_runs(case)
    channels = joint_channels(plant, fit[0])
    tendons = [f"tendon:{plant.model.tendon(i).name}" for i in range(plant.model.ntendon)]
    places = (*(f"joint:{plant.model.joint(i).name}" for i in range(plant.model.njnt)), *tendons)
    rows = np.vstack([np.eye(plant.model.nv), *(plant.port_rows([name]) for name in tendons)])
    data = {window: [states_of(run, channels, window) for run in fit] for window in sorted({f.window_s for f in FORMS})}
    columns = Columns.scaled(places, rows, data[FORMS[0].window_s])
    tables = {
        (form, library): _tables(columns, form, library, data[form.window_s]) for form in FORMS for library in LIBRARIES
    }
    settings = [(form, library, t) for form, library in tables for t in THRESHOLDS]
    error, count = _cross_validated(columns, tables, settings, fit, data[FORMS[0].window_s], channels)
    good = np.flatnonzero(error <= AS_GOOD * error.min())
    form, library, threshold = settings[good[np.lexsort((error[good], count[good]))[0]]]
    equations = _ensemble(tables[form, library], threshold)
    errors = []
    for run in holdout:
        states = states_of(run, channels, form.window_s)
        errors.append(_free_run_errors(columns, equations[None], library.shapes[None], run, states, channels)[0])
    remark = (
        f"states over {form.window_s:g} s, {f'weak form over {2 * form.half_s:g} s' if form.half_s else 'derivatives'}, "
        f"{library.clearance or ('linear' if library.is_linear else 'no clearance')}, threshold {threshold:g}"
    )
    named = _strongest(equations, columns, library, tables[form, library])
    return PeerResult(named=named, names=NAMES, nrmse=mean_error(errors), remark=remark)


Table = tuple[Array, Array]
"""Rows of a recording: columns (n, n_columns) and accelerations (n, nv)."""


def _tables(columns: Columns, form: Form, library: Library, states: Sequence[States]) -> list[Table]:
    """Return the rows of every recording."""
    out = []
    for own in states:
        x = columns.of(own.q, own.v, own.u, library.shapes)
        if library.is_linear:
            x[:, columns.nonlinear(x.shape[1])] = 0.0
        window = round(form.window_s / own.step_s)
        inside = slice(window, len(x) - window)
        out.append(
            _weak(x[inside], own.v[inside], own.step_s, form.half_s)
            if form.half_s
            else (x[inside][::THINNED], own.a[inside][::THINNED])
        )
    return out


def _weak(x: Array, v: Array, step_s: float, half_s: float) -> Table:
    """Return the columns and accelerations integrated against test functions, by pysindy."""
    from pysindy.feature_library import PolynomialLibrary, WeakPDELibrary
    from pysindy.utils import AxesArray

    known = np.random.get_state()  # noqa: NPY002 (pysindy draws from the global generator)
    np.random.seed(SEED)  # noqa: NPY002
    try:
        weak = WeakPDELibrary(
            function_library=PolynomialLibrary(degree=1, include_bias=False),
            spatiotemporal_grid=step_s * np.arange(len(x)),
            K=DOMAINS,
            H_xt=half_s,
            p=DEGREE,
        )
    finally:
        np.random.set_state(known)  # noqa: NPY002
    axes = {"ax_time": 0, "ax_coord": 1}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # labels of axes
        weak.fit([AxesArray(x, axes)])
        (integrals,) = weak.transform([AxesArray(x, axes)])
        return np.asarray(integrals), np.asarray(weak.convert_u_dot_integral(AxesArray(v, axes)))


def _scales(tables: Sequence[Table]) -> tuple[Array, Array]:
    """Return the rms of columns and accelerations; infinite for columns without content."""
    x, a = (np.sqrt(np.mean(np.vstack([t[i] for t in tables]) ** 2, axis=0)) for i in (0, 1))
    return np.where(x > 0.0, x, np.inf), np.maximum(a, 1e-300)


def _regressed(tables: Sequence[Table], thresholds: Sequence[float]) -> list[Array]:
    """Return the equations (n_columns, nv) of thresholded least squares at every threshold.

    The triangular factor of the rows has the same least squares as the rows.
    """
    from pysindy import STLSQ

    size, target = _scales(tables)
    x, a = (np.vstack([t[i] for t in tables]) for i in (0, 1))
    both: Array = np.asarray(np.linalg.qr(np.hstack([x / size, a / target]), mode="r"))
    count = x.shape[1]
    out = []
    for threshold in thresholds:
        optimiser = STLSQ(threshold=threshold, alpha=RIDGE * len(x))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # all terms of an equation below the threshold
            optimiser.fit(both[:, :count], both[:, count:])
        out.append(np.asarray(optimiser.coef_).T / size[:, None] * target)
    return out


def _cross_validated(
    columns: Columns,
    tables: dict[tuple[Form, Library], list[Table]],
    settings: Sequence[tuple[Form, Library, float]],
    runs: Sequence[Run],
    states: Sequence[States],
    channels: dict[int, tuple[str, int]],
) -> tuple[Array, Array]:
    """Return free-run error and number of nonlinear terms of every setting.

    Of a single recording, the error is on the recording itself.
    """
    shapes = np.array([library.shapes for _, library, _ in settings])
    errors, counts = [], []
    for i, run in enumerate(runs):
        equations = np.array(
            [
                found
                for own in tables.values()
                for found in _regressed([t for j, t in enumerate(own) if j != i] or own, THRESHOLDS)
            ]
        )
        nonlinear = equations[:, columns.nonlinear(equations.shape[1])]
        counts.append(np.count_nonzero(nonlinear, axis=(1, 2)))
        errors.append(_free_run_errors(columns, equations, shapes, run, states[i], channels))
    return np.sqrt(np.mean(np.square(errors), axis=0)), np.sum(counts, axis=0)


def _free_run_errors(
    columns: Columns, equations: Array, shapes: Array, run: Run, states: States, channels: dict[int, tuple[str, int]]
) -> Array:
    """Return the relative errors (n_sets,) of the free runs."""
    with np.errstate(all="ignore"):  # a run that diverges has the largest error
        motion = free_runs(columns, equations, shapes, states)
    order = {name: (dof, order) for dof, (name, order) in channels.items()}
    picked = [order.get(name) for name in compared_names(run)]
    out = []
    for k in range(len(equations)):
        seen = [
            run.measured[name] if at is None else motion[at[1]][:, k, at[0]]  # a second channel of one joint
            for name, at in zip(compared_names(run), picked, strict=True)
        ]
        out.append(error_of(run, np.column_stack(seen)))
    return np.array(out)


def _ensemble(tables: Sequence[Table], threshold: float) -> Array:
    """Return the median equations (n_columns, nv) of bootstrap samples."""
    from pysindy import STLSQ, EnsembleOptimizer

    size, target = _scales(tables)
    x, a = (np.vstack([t[i] for t in tables]) for i in (0, 1))
    kept = np.flatnonzero(np.isfinite(size))
    optimiser = EnsembleOptimizer(STLSQ(threshold=threshold, alpha=RIDGE * len(x)), bagging=True, n_models=MODELS)
    known = np.random.get_state()  # noqa: NPY002 (pysindy draws from the global generator)
    np.random.seed(SEED)  # noqa: NPY002
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optimiser.fit(x[:, kept] / size[kept], a / target)
    finally:
        np.random.set_state(known)  # noqa: NPY002
    out = np.zeros((x.shape[1], a.shape[1]))
    out[kept] = np.median(optimiser.coef_list, axis=0).T / size[kept, None] * target
    return out


def _strongest(equations: Array, columns: Columns, library: Library, tables: Sequence[Table]) -> Named | None:
    """Return the nonlinear term with the largest share of an acceleration."""
    size, target = _scales(tables)
    laws = columns.nonlinear(len(equations))
    shares = np.max(np.abs(equations * np.where(np.isfinite(size), size, 0.0)[:, None] / target), axis=1)[laws]
    best = int(np.argmax(shares))
    if not shares[best] > 0.0:
        return None
    place, law = divmod(best, len(library.effects))
    return Named(effect=library.effects[law], place=columns.places[place], share=float(shares[best]))
