"""Settings of the predictors."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FrequencySettings:
    """Settings of `vlab.diagnose.predictors.frequency`."""

    step: float = 1e-4
    """step [1]: relative finite-difference step of effect parameters, above 0; default untested. Raising it adds
    truncation error."""


@dataclass(frozen=True, kw_only=True)
class FrequencyModelSettings:
    """Settings of `vlab.diagnose.predictors.frequency_model`."""

    most_modes: int = 40
    """most_modes [1]: most modes of a large model, from the lowest, at least 1; default untested. Raising it costs
    time."""
    unstable: float = 1e-3
    """unstable [rad/s]: modulus of an imaginary natural frequency from which a model is unstable, above 0; default
    above rounding. Raising it tolerates negative stiffness."""


@dataclass(frozen=True, kw_only=True)
class FrequencyModesSettings:
    """Settings of `vlab.diagnose.predictors.frequency_modes`."""

    least_part: float = 0.02
    """least_part [1]: least participation of the structure in a pole that counts as mode, 0 to 1; default untested.
    Raising it drops more poles of attachments."""


@dataclass(frozen=True, kw_only=True)
class FrequencyResidualSettings:
    """Settings of `vlab.diagnose.predictors.frequency_residual`."""

    independent: float = 40.0
    """independent [1]: effective sample size of one response, however many lines, above 0; default untested. Model
    error is correlated over lines; raising it weights responses more against priors."""
    band_error: float = 0.15
    """band_error [1]: standard deviation of the log amplitude in a band of the coarse residual, above 0; default
    untested. Raising it flattens the coarse cost."""
    skipped: float = 6.0
    """skipped [sd]: cost of a model mode missing from the table, above 0; default untested. Raising it skips fewer
    model modes."""
    own_part: float = 0.3
    """own_part [1]: participation of the structure below which a mode is a resonance of an attachment, 0 to 1; default
    untested. Raising it penalises more modes."""
    part_cost: float = 3.0
    """part_cost [sd]: cost per factor of e by which participation falls below `own_part`, above 0; default untested.
    Raising it pairs attachment resonances less."""
    far: float = 30.0
    """far [sd]: bound of the cost of a pairing, above 0; default untested. Raising it weights outlying modes more."""


@dataclass(frozen=True, kw_only=True)
class EquivalentTableSettings:
    """Settings of `vlab.diagnose.predictors.equivalent_table`."""

    per_decade: int = 16
    """per_decade [1]: tabulated amplitudes per decade, at least 4; the default interpolates powers of the amplitude to
    1e-4. Raising it resolves edges of laws better and costs time."""
    most_decades: int = 12
    """most_decades [1]: decades of amplitude on either side of the median, at least 1; default beyond all responses.
    Raising it costs memory."""
    frequencies: int = 7
    """frequencies [1]: tabulated frequencies over a band for laws of displacement and velocity, at least 1; default
    untested. Raising it costs time."""


@dataclass(frozen=True, kw_only=True)
class LevelModesSettings:
    """Settings of `vlab.diagnose.predictors.level_modes`."""

    passes: int = 6
    """passes [1]: most passes over shape and equivalents of a mode, at least 1; default untested. Raising it helps
    strong nonlinearity and costs time."""
    settled: float = 1e-6
    """settled [1]: relative change of a pole that ends the passes, above 0; default far below the accuracy of tables.
    Raising it saves time."""


@dataclass(frozen=True, kw_only=True)
class LevelResponseSettings:
    """Settings of `vlab.diagnose.predictors.level_response`."""

    reach: tuple[float, float] = (1.5, 1.0)
    """reach [decades]: searched amplitudes below the smallest and above the largest linear one, above 0; default
    untested. Raising it finds more distant solutions and costs time."""
    per_decade: int = 8
    """per_decade [1]: tested amplitudes per decade, at least 4; default untested. Raising it separates neighbouring
    solutions and costs time."""
    refined: int = 8
    """refined [1]: steps of bisection and secant per solution, at least 4; default for 1e-6 of the amplitude. Raising
    it costs time."""
    sweeps: int = 30
    """sweeps [1]: most passes over several nonlinear ports, at least 1; default untested. Raising it helps strongly
    coupled ports."""
    settled: float = 1e-6
    """settled [1]: relative change of amplitudes that ends the passes, above 0; default far below measurement noise.
    Raising it saves time."""
    least_turn: float = 0.05
    """least_turn [1]: bound of the determinant of the feedback from amplitude to stiffness, 0 to 1; default untested.
    The determinant vanishes where a branch turns back; raising the bound shortens steps of a fit there."""


@dataclass(frozen=True, kw_only=True)
class InnovationsSettings:
    """Settings of `vlab.diagnose.predictors.innovations`."""

    forgotten: float = 1e-7
    """forgotten [1]: share of its maximum below which an impulse response is truncated, above 0; default untested.
    Raising it shortens filters at a larger error."""


@dataclass(frozen=True, kw_only=True)
class KalmanSettings:
    """Settings of `vlab.diagnose.predictors.kalman`."""

    most_riccati: int = 4000
    """most_riccati [samples]: samples after which the covariance counts as stationary, above 0; default untested.
    Raising it costs time and memory."""
    few: int = 64
    """few [samples]: initially allocated covariances, at least 1; default for 320 kB each at a hundred modes. Raising
    it costs memory."""
    settled: float = 1e-6
    """settled [1]: change of the covariance per sample over its largest entry at stationarity, above 0; default
    untested. Raising it stops the recursion earlier."""
    tuning_samples: int = 2500
    """tuning_samples [samples]: first samples of every run for the likelihood of the unknown-force intensity, above 0;
    default untested. Raising it costs time."""
    start_steps: int = 64
    """start_steps [samples]: free motion in which every state is compared with the channels for its initial covariance, at
    least 1; default untested. Raising it tightens the covariance of slow states."""
    decades: tuple[float, float, float] = (-8.0, 9.0, 1.5)
    """decades [decades]: first, end and step of the search for the unknown-force intensity about its scale; default
    untested. A wider search costs evaluations."""
    finer: tuple[float, float] = (0.75, 0.375)
    """finer [decades]: half-widths of the two finer searches for the intensity, above 0; default halves of the step.
    Raising them costs resolution."""
    converged: float = 1.5
    """converged [1]: trace of the innovations' covariance over the stationary one below which a filter has converged,
    above 1; default untested. Raising it uses earlier samples."""


@dataclass(frozen=True, kw_only=True)
class ModalSettings:
    """Settings of `vlab.diagnose.predictors.modal`."""

    steps_per_cycle: float = 22.0
    """steps_per_cycle [1]: integration steps per cycle of the highest frequency under nonlinear forces, above 2;
    default for 0.7 % phase error at second order. Raising it costs time."""
    finer: int = 2
    """finer [1]: factor on the steps for nonsmooth laws such as stick-slip, hysteresis and clearance, at least 1;
    default untested. Raising it locates events better and costs time."""
    residual_vectors: int = 3
    """residual_vectors [1]: residual vectors of a port with a law, at least 1; default set on stick-slip at a crosspiece of
    the beam (one concealed case): the errors against MuJoCo are 41 % with one, 1.3 % with two and 0.8 % with three.
    Raising it costs time."""
    equilibrium_steps: int = 20
    """equilibrium_steps [1]: steps to the static force of a law at the start of a run, at least 1; default for a cubic spring
    ten times as stiff as its place. Raising it costs little time."""
    brief: float = 0.01
    """brief [1]: time over the sample period for the rate of a law's static force, above 0; default untested. Raising it
    smooths the rate."""
    independent: float = 1e-9
    """independent [1]: least part of a unit residual vector outside the others for a direction of its own, 0 to 1;
    default above rounding. Raising it merges close ports."""


@dataclass(frozen=True, kw_only=True)
class ModalIntegrationSettings:
    """Settings of `vlab.diagnose.predictors.modal_integration`."""

    most_alike: float = 1e8
    """most_alike [1]: largest condition number of the step's eigenvectors for modal integration, above 1; default half
    of all digits. Raising it integrates worse-conditioned systems in modal form."""


@dataclass(frozen=True, kw_only=True)
class OwnNonlinearitySettings:
    """Settings of `vlab.diagnose.predictors.own_nonlinearity`."""

    small: float = 1e-5
    """small [1]: displacement, velocity and acceleration in SI units for the linearisation, above 0; default untested.
    Raising it adds truncation error."""
    least_omega: float = 1.0
    """least_omega [rad/s]: lowest natural frequency of a slave mode, above 0; default untested. Slower unobserved modes
    stay at rest; raising it fixes more modes."""
    passes: int = 2
    """passes [1]: fixed-point passes for slave motion and forces, at least 1; default untested. Raising it converges
    the forces further."""


@dataclass(frozen=True, kw_only=True)
class ScopeSettings:
    """Settings of `vlab.diagnose.predictors.scope`."""

    far: float = 0.02
    """far [1]: relative error of linear accelerations on the recorded motion from which the model class is
    trajectory-linearised, above 0. A pendulum reaches the default at 20 degrees; raising it keeps more models
    time-invariant."""
    exact: float = 1e-7
    """exact [1]: relative error of linear accelerations under large displacement below which a model is linear, above
    0; default untested. Raising it accepts weak nonlinearity without a recording."""
    large: float = 0.3
    """large [1]: trial displacement in rad or m and velocity per second of the linearity test, above 0; default
    untested. Raising it detects weaker nonlinearity."""
    slowest: float = 1e-3
    """slowest [rad/s]: frequency whose accelerations count as zero, above 0; default untested. Raising it tolerates
    errors of unrestrained masses."""
    part: int = 1200
    """part [samples]: part of a recording around its peak whose states are estimated, above 0; default untested.
    Raising it costs time."""
    looks: int = 60
    """looks [1]: states of a recording at which accelerations are compared, at least 2; default untested. Raising it
    costs time."""
    most_coordinates: int = 30
    """most_coordinates [1]: most degrees of freedom of a trajectory-linearised model, at least 1; default untested.
    Raising it costs time."""
    grown: float = 6.0
    """grown [1]: log growth of an unstable mode over a recording from which an unknown control law is assumed, above 0;
    default untested. Raising it refuses fewer cases."""


@dataclass(frozen=True, kw_only=True)
class StepJacobianSettings:
    """Settings of `vlab.diagnose.predictors.step_jacobian`."""

    step: float = 1e-6
    """step [1]: forward-difference step in rad or m, or per second, above 0; default untested. Raising it adds
    truncation error."""
    short: float = 1e-4
    """short [s]: time step from which derivatives of the motion are computed, above 0; default untested. Raising it
    adds truncation error."""
    accurate: float = 1e-5
    """accurate [1]: relative change of an interval's motion by finer substeps that is allowed, above 0; default
    untested. Raising it takes fewer substeps."""
    most_substeps: int = 64
    """most_substeps [1]: most substeps of a sample interval, at least 1; default untested. Raising it costs time."""
    trial_substeps: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    """trial_substeps [1]: substeps that are compared with the finest, from 1, rising; default powers of two. A further
    entry costs one evaluation."""
    stable: float = 2.78
    """stable [1]: largest product of substep and decay rate, above 0; default from the stability of the classical Runge-Kutta
    method of fourth order (Hairer and Wanner 1996, section IV.2). Raising it lets stiff plants diverge."""
    resolved: float = 0.5
    """resolved [1]: largest product of substep and decay rate in the finest substeps, above 0; default from the method's
    local error of 3e-4 of a decaying motion. Raising it takes fewer substeps."""
    compared: int = 12
    """compared [1]: intervals of a run on which substeps are compared, at least 1; default untested. Raising it costs
    time."""


@dataclass(frozen=True, kw_only=True)
class TrajectorySettings:
    """Settings of `vlab.diagnose.predictors.trajectory`."""

    fine: int = 4
    """fine [1]: substeps of a sample interval under port laws, and its parts under late commands, at least 1; default
    untested. Raising it locates stops, reversals and changes of commands better and costs time."""
    tuning_samples: int = 600
    """tuning_samples [samples]: first samples of every run for the likelihood of the unknown-force intensity, above 0;
    default untested. Raising it costs time."""
    at_rest: float = 1e-3
    """at_rest [1]: standard deviation of an initial state at rest over the largest motion of its kind, above 0; default
    untested. Raising it loosens the initial state."""
    unknown: float = 0.3
    """unknown [1]: standard deviation of an unknown initial state over the largest motion of its kind, above 0; default
    untested. Raising it loosens the initial state."""
    decades: tuple[float, float, float] = (-8.0, 9.0, 1.0)
    """decades [decades]: first, end and step of the search for the unknown-force intensity about its scale; default
    untested. A wider search costs evaluations."""
    finer: tuple[float, ...] = (-0.6, -0.3, 0.0, 0.3, 0.6)
    """finer [decades]: trial intensities about the best of the search; default untested. A further entry costs one
    evaluation."""
    about_earlier: tuple[float, ...] = (-3.0, -2.0, -1.2, -0.8, -0.4, 0.0, 0.4)
    """about_earlier [decades]: trial intensities about an earlier one, which mostly falls; default untested. A further
    entry costs one evaluation."""


@dataclass(frozen=True, kw_only=True)
class ErrorGrowthSettings:
    """Settings of `vlab.diagnose.predictors.error_growth`."""

    most: float = 7.4
    """most [1]: growth of a small error over a part of an unstable recording, above 1; default two e-foldings, untested.
    Raising it lengthens the parts."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryDataSettings:
    """Settings of `vlab.diagnose.predictors.trajectory_data`."""

    most_samples: int = 2500
    """most_samples [samples]: longest part of a run in the search, above 0; default untested. Raising it costs time;
    the verdict always uses whole runs."""
    wide: float = 0.5
    """wide [1]: standard deviation of an unknown initial state of the smoother over the largest motion of its kind,
    above 0; default untested. Raising it loosens the initial state."""
    smoothing: tuple[float, float] = (-8.0, 4.0)
    """smoothing [decades]: range of the splines' penalty over the cube of the mean interval; default untested. A wider
    range costs resolution."""
    halvings: int = 4
    """halvings [1]: bisections of the splines' penalty, at least 1; default untested. Raising it brings the residual
    closer to the noise."""
    most_noise: float = 1.25
    """most_noise [1]: largest noise by neighbouring samples over that by the spectrum, at least 1; default the bias of a
    median over few segments, untested. Raising it weights such channels less."""
    rates: float = 5.0
    """rates [1/s]: spread of initial rates over that of positions, above 0; default untested. Raising it loosens the
    initial state."""
    accelerations: float = 5.0
    """accelerations [1]: unknown accelerations of the smoother over the rms velocity per second, above 0; default
    untested. Raising it follows the channels closer."""
    measured: float = 0.1
    """measured [1]: factor on the initial spread of measured positions, 0 to 1; default untested. Raising it loosens the
    initial state."""
    floor: float = 0.01
    """floor [1]: share of a channel's rms added to its noise in the smoother, above 0; default untested. Raising it
    smooths more."""
    still: float = 1e-3
    """still [SI units per second]: rate added to the rms velocity in the smoother, above 0; default untested. Raising it
    follows slow motion closer."""
    known_start: float = 1e-8
    """known_start [SI units squared]: variance of an initial state at rest in the smoother, above 0; default above
    rounding. Raising it loosens the initial state."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryIntegrationSettings:
    """Settings of `vlab.diagnose.predictors.trajectory_integration`."""

    far: float = 1e6
    """far [1]: magnitude in SI units to which the deviation of a diverged trial is clipped, above 0; default untested.
    Raising it risks overflow."""
    check_every: int = 8
    """check_every [steps]: interval of the divergence check, at least 1; default untested. Raising it saves time and
    detects divergence later."""


FREQUENCY = FrequencySettings()
FREQUENCY_MODEL = FrequencyModelSettings()
FREQUENCY_MODES = FrequencyModesSettings()
FREQUENCY_RESIDUAL = FrequencyResidualSettings()
EQUIVALENT_TABLE = EquivalentTableSettings()
ERROR_GROWTH = ErrorGrowthSettings()
INNOVATIONS = InnovationsSettings()
KALMAN = KalmanSettings()
LEVEL_MODES = LevelModesSettings()
LEVEL_RESPONSE = LevelResponseSettings()
MODAL = ModalSettings()
MODAL_INTEGRATION = ModalIntegrationSettings()
OWN_NONLINEARITY = OwnNonlinearitySettings()
SCOPE = ScopeSettings()
STEP_JACOBIAN = StepJacobianSettings()
TRAJECTORY = TrajectorySettings()
TRAJECTORY_DATA = TrajectoryDataSettings()
TRAJECTORY_INTEGRATION = TrajectoryIntegrationSettings()
