"""Settings of the parametrised model: priors and locations."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class GeometrySettings:
    """Settings of `vlab.diagnose.parameters.geometry`."""

    sd: dict[str, float] = field(default_factory=lambda: {"inertia": 0.03, "length": 0.003})
    """sd [1]: relative prior standard deviations of inertia and length where a case states none, above 0; default from
    drawings, untested. Small motion identifies both as mass and stiffness only; raising an entry frees that kind."""
    unknown: dict[str, float] = field(default_factory=lambda: {"inertia": 0.5, "length": 0.1})
    """unknown [1]: relative prior standard deviations of inertia and length of a sketch, above `sd`; default set on
    two real pendulums, whose drawings err by 49 % in inertia and by 10 % in length. Raising an entry leaves that kind to the recordings."""
    hanging: float = 0.5
    """hanging [1]: share of gravity in a mode's stiffness above which gravity is its spring, 0 to 1; default the larger
    part. Raising it frees the geometry of fewer models."""
    step: float = 0.01
    """step [1]: relative step of gravity, masses and distances in differences of the modal matrices, above 0; default
    numerical, for polynomials of second degree. Raising it adds error where the equilibrium moves."""
    least: float = 1e-6
    """least [m]: least distance of a centre of mass from an axis, above 0; default numerical. Raising it fixes more
    centres."""


@dataclass(frozen=True, kw_only=True)
class LocationsSettings:
    """Settings of `vlab.diagnose.parameters.locations`."""

    same: float = 1e-6
    """same [1]: relative difference of two port rows up to which the ports are one, above 0; default untested. Raising
    it merges more ports."""
    most_ports: int = 80
    """most_ports [1]: most ports of a model in the search, at least 1; default untested. Raising it costs time."""
    most_picked_up: int = 16
    """most_picked_up [1]: most sensors between which crosstalk is searched, at least 1; default untested. Raising it
    costs time."""
    free: float = 0.1
    """free [rad/s]: natural frequency below which a mode is rigid-body motion, above 0; default untested. Raising it
    treats soft suspensions as free."""


@dataclass(frozen=True, kw_only=True)
class MeshCorrectionSettings:
    """Settings of `vlab.diagnose.parameters.mesh_correction`."""

    wider: float = 2.0
    """wider [1]: highest corrected natural frequency over the highest recorded frequency, above 1; default untested.
    Pulses excite modes above the band; raising it corrects more modes."""
    soft: float = 0.01
    """soft [1]: share of the cables' axial stiffness that removes stretch stiffening but keeps tension and modes, 0 to
    1; default untested. Raising it leaves some stiffening."""


@dataclass(frozen=True, kw_only=True)
class MeshedStructureSettings:
    """Settings of `vlab.diagnose.model_kinds.meshed_structure`."""

    band: float = 1.1
    """band [1]: highest mode with an uncertain frequency over the highest recorded frequency, above 0; default
    untested. Raising it adds parameters that only compliance identifies."""


@dataclass(frozen=True, kw_only=True)
class MjcfPriorsSettings:
    """Settings of `vlab.diagnose.parameters.mjcf`."""

    default_sd: dict[str, float] = field(
        default_factory=lambda: {
            "stiffness": 0.05,
            "damping": 0.3,
            "friction": 0.3,
            "mass": 0.03,
            "armature": 0.05,
            "gain": 0.05,
            "velocity-gain": 0.05,
            "sensor": 0.01,
        }
    )
    """default_sd [1]: relative prior standard deviations by kind where a case states none, above 0; default from
    drawings, data sheets and calibration, untested. Raising an entry frees that kind."""
    least_factor: float = 1e-3
    """least_factor [1]: factor that stands for a vanishing value, 0 to 1; default untested. Raising it keeps a rest of
    damping where there is none."""
    common: float = 0.25**0.5
    """common [1]: standard deviation of a kind's common factor over that of the kind, 0 to 1; default untested. Raising
    it correlates the elements of one drawing more; `common` and `own` add to 1 in square."""
    own: float = 0.75**0.5
    """own [1]: standard deviation of an element's own factor over that of its kind, 0 to 1; default untested. Raising
    it decorrelates the elements."""
    most_elements: int = 12
    """most_elements [1]: most elements of a kind with a factor each, at least 1; default untested. A longer chain of
    links is one bar with a common factor; raising it adds parameters."""


@dataclass(frozen=True, kw_only=True)
class ModeSelectionSettings:
    """Settings of `vlab.diagnose.parameters.mode_selection`."""

    most_modes: int = 24
    """most_modes [1]: most modes of the reduced model, at least 1; default untested. Raising it costs time."""
    few: int = 8
    """few [1]: number of modes up to which all are dynamic within the sampled band, at least 1; default untested.
    Raising it keeps the local compliance of gaps and slips in larger models."""
    band_margin: float = 2.0
    """band_margin [1]: highest dynamic mode over the highest recorded frequency, above 1; default untested. Modes above
    are quasi-static; raising it costs time."""
    seen: float = 0.45
    """seen [1]: highest dynamic mode over the sample rate, 0 to 0.5; default untested. Raising it keeps modes closer to
    the Nyquist frequency."""
    no_phase: float = 1e-12
    """no_phase [1]: imaginary part below which a pole of the discrete step is real, above 0; default above rounding.
    Raising it classifies more negative poles as real."""
    lagging: float = 30.0
    """lagging [1]: corner of an overdamped mode over the band up to which the mode is kept, above 1. A lag turns phase
    by 2 degrees at one thirtieth of its corner; raising it keeps faster lags."""
    above_lowest: float = 1.5
    """above_lowest [1]: least upper end of the band over the lowest observable natural frequency, above 1; default
    untested. Raising it keeps more modes of slow recordings."""


@dataclass(frozen=True, kw_only=True)
class ObservationSettings:
    """Settings of `vlab.diagnose.parameters.observation`."""

    step: float = 1e-6
    """step [1]: central-difference step of joint motions in m or rad, or per second, above 0; default untested. Raising
    it adds truncation error."""


@dataclass(frozen=True, kw_only=True)
class RecordedRunsSettings:
    """Settings of `vlab.diagnose.parameters.recorded_runs`."""

    least_samples: int = 64
    """least_samples [samples]: shortest recording with a spectrum that has a noise floor, above 0; default untested.
    Raising it refuses more cases."""
    fewest_samples: int = 16
    """fewest_samples [samples]: shortest recording beside one of `least_samples`, whose noise it takes, above 0; default
    untested. Raising it leaves out more recordings."""


@dataclass(frozen=True, kw_only=True)
class ReducedModelSettings:
    """Settings of `vlab.diagnose.parameters.reduced_model`."""

    most: float = 3.0
    """most [1]: bound of the log factor of a parameter, above 0; default untested. Raising it risks overflow in
    diverged trials."""
    slope: float = 0.01
    """slope [sd]: central-difference step of the damping derivative, above 0; default untested. Raising it adds
    truncation error."""
    least_seen: float = 3e-4
    """least_seen [1]: least displacement of a mode in a channel over the largest mode's for an observable mode, above
    0; default untested. Raising it drops more modes."""


@dataclass(frozen=True, kw_only=True)
class StaticOffsetSettings:
    """Settings of `vlab.diagnose.parameters.static_offset`."""

    stands_off: float = 3.0
    """stands_off [sd]: least mean of a channel over its standard deviation for a static offset, above 0; default
    untested. Raising it reports fewer offsets."""
    alike: float = 1.0
    """alike [sd]: largest spread of the means over recordings for one static offset, above 0; default untested. Raising
    it reports more offsets."""


@dataclass(frozen=True, kw_only=True)
class StructurePriorsSettings:
    """Settings of `vlab.diagnose.parameters.structure`."""

    step: float = 1e-3
    """step [1]: central-difference step of the log factor of a structure's parameter, above 0; default untested.
    Raising it adds truncation error."""
    structure_sd: dict[str, float] = field(
        default_factory=lambda: {
            "tension": 0.05,
            "frequency": 0.003,
            "place": 1e-3,
            "span-stiffness": 0.02,
            "span-mass": 0.007,
        }
    )
    """structure_sd [1]: prior standard deviations of tension and mode frequencies, relative, and of sensor positions
    [m], above 0. Composites of 16 links err by up to 0.2 % in frequency below 50 Hz; raising an entry frees that kind.
    """
    uneven: float = 0.5
    """uneven [1]: stiffness of neighbouring spans at the start of the search, in prior standard deviations up and down,
    above 0; default untested. Raising it leaves the symmetric structure faster and begins farther from an even one."""
    of_fe_sd: float = 0.001
    """of_fe_sd [1]: relative prior standard deviation of frequencies that the plant takes from the FE model, above 0.
    The linear reduced model errs by as much at some per cent parameter change; raising it absorbs stiffness and mass
    errors."""


@dataclass(frozen=True, kw_only=True)
class TermsSettings:
    """Settings of `vlab.diagnose.parameters.terms`."""

    unidentifiable: float = 1.0
    """unidentifiable [1]: standard deviation of a log amplitude from which the amplitude may be zero, above 0; default
    untested. Raising it keeps more terms."""
    nothing: float = 1e-3
    """nothing [1]: amplitude over the largest of the same unit below which a term is dropped, above 0; default
    untested. Raising it drops more terms."""


@dataclass(frozen=True, kw_only=True)
class ToleranceSettings:
    """Settings of `vlab.diagnose.parameters.tolerance`."""

    most: float = 2.0
    """most [sd]: largest change of a modal mass, damping or stiffness within the stated uncertainty, above 0; default for
    the 95 % that a tolerance states. Raising it drops more small linear effects."""


@dataclass(frozen=True, kw_only=True)
class ProblemSettings:
    """Settings of `vlab.diagnose.problem`."""

    model_error: float = 0.002
    """model_error [1]: error of a well-integrated model over a channel's rms in the weights of fits, above 0; default
    untested. Raising it weights strong channels less."""
    integration_error: float = 5e-4
    """integration_error [1]: integration error of a complete user model over a channel's rms, above 0; default
    untested. Raising it counts more residual as numerical."""
    mesh_own_error: float = 0.005
    """mesh_own_error [1]: hold-out residual of a complete structure after a refit over the rms, above 0; default from
    0.002 to 0.008 on the beam with nothing hidden. Raising it reports fewer effects; the weights use `model_error`."""
    long: float = 0.9
    """long [1]: searched share of a recording below which a note is written, 0 to 1; default untested. Raising it
    writes more notes."""


GEOMETRY = GeometrySettings()
LOCATIONS = LocationsSettings()
MESH_CORRECTION = MeshCorrectionSettings()
MESHED_STRUCTURE = MeshedStructureSettings()
MJCF_PRIORS = MjcfPriorsSettings()
MODE_SELECTION = ModeSelectionSettings()
OBSERVATION = ObservationSettings()
RECORDED_RUNS = RecordedRunsSettings()
REDUCED_MODEL = ReducedModelSettings()
STATIC_OFFSET = StaticOffsetSettings()
STRUCTURE_PRIORS = StructurePriorsSettings()
TERMS = TermsSettings()
TOLERANCE = ToleranceSettings()
PROBLEM = ProblemSettings()
