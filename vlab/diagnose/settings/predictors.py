"""Settings of the predictors."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class FrequencySettings:
    """Settings of `vlab.diagnose.predictors.frequency`."""

    step: float = 1e-4
    """Step of the derivatives by an effect's parameters, as a share of them."""


@dataclass(frozen=True, kw_only=True)
class FrequencyModelSettings:
    """Settings of `vlab.diagnose.predictors.frequency_model`."""

    most_modes: int = 40
    """Modes that are kept of a large model, from the lowest on."""
    unstable: float = 1e-3
    """A mode with negative stiffness above this circular frequency [rad/s] makes a model unstable."""


@dataclass(frozen=True, kw_only=True)
class FrequencyModesSettings:
    """Settings of `vlab.diagnose.predictors.frequency_modes`."""

    least_part: float = 0.02
    """Share of a mode that the structure must have for it to count as one."""


@dataclass(frozen=True, kw_only=True)
class FrequencyResidualSettings:
    """Settings of `vlab.diagnose.predictors.frequency_residual`."""

    independent: float = 40.0
    """Independent numbers that one response counts as, however many lines it has: what a model leaves is its own error, which is
    alike on neighbouring lines."""
    band_error: float = 0.15
    """Error of the logarithm of the power in a band that the coarse view allows."""
    skipped: float = 6.0
    """What a mode of the model that the table does not list costs, in standard deviations."""
    own_part: float = 0.3
    """A table lists modes of the structure: one that is mostly the resonance of something on it, less than this share the
    structure's, costs so many standard deviations for every factor of e that it is below."""
    part_cost: float = 3.0
    """See `own_part`."""
    far: float = 30.0
    """Difference in standard deviations beyond which a pairing of modes costs no more."""


@dataclass(frozen=True, kw_only=True)
class InnovationsSettings:
    """Settings of `vlab.diagnose.predictors.innovations`."""

    forgotten: float = 1e-7
    """Share of its largest value below which an impulse response has ended: the precision of the columns."""


@dataclass(frozen=True, kw_only=True)
class KalmanSettings:
    """Settings of `vlab.diagnose.predictors.kalman`."""

    most_riccati: int = 4000
    """Samples after which covariances are taken as settled, and those that there is room for at first: a hundred modes fill 320 kB each."""
    few: int = 64
    """See `most_riccati`."""
    settled: float = 1e-6
    """Change of the covariance from one sample to the next, as a share of its largest entry, at which it has settled."""
    tuning_samples: int = 2500
    """Samples of every run on which the intensity is tuned."""


@dataclass(frozen=True, kw_only=True)
class ModalSettings:
    """Settings of `vlab.diagnose.predictors.modal`."""

    steps_per_cycle: float = 22.0
    """Integration steps per cycle of the fastest motion where a nonlinear force acts: of second order, 0.7 % in phase; and how many times
    more where a law has edges in time: dry friction sticks and breaks away, hysteresis turns round, a gap closes within a step."""
    finer: int = 2
    """See `steps_per_cycle`."""


@dataclass(frozen=True, kw_only=True)
class ModalIntegrationSettings:
    """Settings of `vlab.diagnose.predictors.modal_integration`."""

    most_alike: float = 1e8
    """Condition of a step's own directions up to which states are marched along them: half of all digits are left."""


@dataclass(frozen=True, kw_only=True)
class ModalProblemSettings:
    """Settings of `vlab.diagnose.predictors.modal_problem`."""

    band: float = 1.1
    """Modes of a structure up to this multiple of the highest frequency recorded have an uncertain frequency of their own."""


@dataclass(frozen=True, kw_only=True)
class OwnNonlinearitySettings:
    """Settings of `vlab.diagnose.predictors.own_nonlinearity`."""

    small: float = 1e-5
    """Displacements, velocities and accelerations at which the model is taken for linear."""
    least_omega: float = 1.0
    """Slower modes that no channel sees stay where they are [rad/s]."""
    passes: int = 2
    """The first gives the slaves' motion, the second the forces with it."""


@dataclass(frozen=True, kw_only=True)
class ScopeSettings:
    """Settings of `vlab.diagnose.predictors.scope`."""

    far: float = 0.02
    """Share of the accelerations that the linear model may miss on the recorded motion; beyond it the search goes along the
    motion. A pendulum gets there at 20 degrees."""
    exact: float = 1e-7
    """A model whose accelerations stay linear to this share under large displacements is linear: no recording is needed."""
    large: float = 0.3
    """Those displacements [rad or m], and velocities [per second]."""
    slowest: float = 1e-3
    """Accelerations as small as those of a motion this slow [rad/s] count as none: a mass that nothing holds has no others."""
    part: int = 1200
    """Samples of a recording that its states are found on."""
    looks: int = 60
    """States of a recording at which the accelerations are compared."""
    most_coordinates: int = 30
    """Degrees of freedom of a model that the search along the motion takes on."""
    grown: float = 6.0
    """An unstable model whose motion grows by this log-factor over a recording was held by something."""


@dataclass(frozen=True, kw_only=True)
class StepJacobianSettings:
    """Settings of `vlab.diagnose.predictors.step_jacobian`."""

    step: float = 1e-6
    """Step of the forward differences [rad, m, or their rates]."""
    short: float = 1e-4
    """Length of the step that derivatives of the motion are read off [s]."""
    accurate: float = 1e-5
    """Change of a sample interval's motion, beside its largest, that a finer step may still make."""
    most_substeps: int = 64


@dataclass(frozen=True, kw_only=True)
class TrajectorySettings:
    """Settings of `vlab.diagnose.predictors.trajectory`."""

    fine: int = 4
    """Steps of a sample interval where dry friction acts: it may stop or reverse anywhere in it."""
    tuning_samples: int = 600
    """Samples of every run on which the intensity of the unknown forces is tuned."""
    at_rest: float = 1e-3
    """Spread of a first state that is at rest, as a share of the largest motion of its kind."""
    unknown: float = 0.3
    """Spread of a first state otherwise."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryDataSettings:
    """Settings of `vlab.diagnose.predictors.trajectory_data`."""

    most_samples: int = 2500
    """The search looks at a part of longer runs, see `liveliest`; the verdict at all of them."""
    wide: float = 0.5
    """Spread of an unknown first state, as a share of the largest motion of its kind."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryIntegrationSettings:
    """Settings of `vlab.diagnose.predictors.trajectory_integration`."""

    far: float = 1e6
    """Deviations stop growing here: such a trial is worth its large residual, and no more; and steps between two looks for such trials."""
    check_every: int = 8
    """See `far`."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryPriorsSettings:
    """Settings of `vlab.diagnose.predictors.trajectory_problem`."""

    geometry_sd: dict[str, float] = field(default_factory=lambda: {"inertia": 0.03, "length": 0.003})
    """Relative standard deviations of moments of inertia and of lengths where a case says nothing: drawings are good to that.
    Near rest they act like masses and stiffnesses; far from it they do not."""


FREQUENCY = FrequencySettings()
FREQUENCY_MODEL = FrequencyModelSettings()
FREQUENCY_MODES = FrequencyModesSettings()
FREQUENCY_RESIDUAL = FrequencyResidualSettings()
INNOVATIONS = InnovationsSettings()
KALMAN = KalmanSettings()
MODAL = ModalSettings()
MODAL_INTEGRATION = ModalIntegrationSettings()
MODAL_PROBLEM = ModalProblemSettings()
OWN_NONLINEARITY = OwnNonlinearitySettings()
SCOPE = ScopeSettings()
STEP_JACOBIAN = StepJacobianSettings()
TRAJECTORY = TrajectorySettings()
TRAJECTORY_DATA = TrajectoryDataSettings()
TRAJECTORY_INTEGRATION = TrajectoryIntegrationSettings()
TRAJECTORY_PRIORS = TrajectoryPriorsSettings()
