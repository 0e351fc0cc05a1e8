"""Settings of the parametrised model: priors and locations."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class LocationsSettings:
    """Settings of `vlab.diagnose.parameters.locations`."""

    same: float = 1e-6
    """Two ports are one where their rows differ by less than this share."""
    most_ports: int = 80
    most_picked_up: int = 16
    """Beyond this many sensors none is taken to see what another one sees."""
    free: float = 0.1
    """Angular frequency [rad/s] below which a mode is free motion."""


@dataclass(frozen=True, kw_only=True)
class MeshCorrectionSettings:
    """Settings of `vlab.diagnose.parameters.mesh_correction`."""

    wider: float = 2.0
    """Modes up to this multiple of the highest frequency recorded are those of the FE model: pulses and edges go beyond the others."""
    soft: float = 0.01
    """Share of the cables' stiffness along their length that leaves nothing of what their stretching adds: tension and modes stay."""


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
            "sensor": 0.01,
        }
    )
    """Relative standard deviations where a case says nothing: drawings and data sheets are good to some per cent, damping and
    friction are known to a third, sensors are calibrated."""
    common: float = 0.25**0.5
    """Elements of a kind have a common factor and each one of its own, of these shares of the kind's standard deviation: parts of one
    drawing have some error in common, and every element deviates by just what is stated."""
    own: float = 0.75**0.5
    """See `common`."""
    most_elements: int = 12
    """Beyond this many elements of a kind only the common factor is uncertain: a chain of links is one bar."""


@dataclass(frozen=True, kw_only=True)
class ModeSelectionSettings:
    """Settings of `vlab.diagnose.parameters.mode_selection`."""

    most_modes: int = 24
    few: int = 8
    """So many modes are all followed, as far as samples tell: a gap or a slip feels how a place yields beside it."""
    band_margin: float = 2.0
    """Modes up to this multiple of the fastest motion recorded are kept: those above follow statically."""
    seen: float = 0.45
    """Share of the sample rate beyond which no mode is followed."""
    no_phase: float = 1e-12
    """A step whose eigenvalues are real and negative turns a motion round at once, as no continuous one does."""
    lagging: float = 30.0
    """A lag turns phases far below its corner: by 2 degrees at one part in so many of it."""


@dataclass(frozen=True, kw_only=True)
class ObservationSettings:
    """Settings of `vlab.diagnose.parameters.observation`."""

    step: float = 1e-6
    """Step of the central differences [largest joint motion, m or rad, or their rates]."""


@dataclass(frozen=True, kw_only=True)
class RecordedRunsSettings:
    """Settings of `vlab.diagnose.parameters.recorded_runs`."""

    least_samples: int = 64
    """What a spectrum takes from which the noise is read."""


@dataclass(frozen=True, kw_only=True)
class ReducedModelSettings:
    """Settings of `vlab.diagnose.parameters.reduced_model`."""

    most: float = 3.0
    """Log-factors beyond this size are taken for it."""
    slope: float = 0.01
    """Step of the derivatives of damping, in standard deviations of the priors."""
    least_seen: float = 3e-4
    """Share of the fastest mode's motion that a channel must see of another one."""


@dataclass(frozen=True, kw_only=True)
class StaticOffsetSettings:
    """Settings of `vlab.diagnose.parameters.static_offset`."""

    stands_off: float = 3.0
    """A channel stands off where its mean is further from rest than this multiple of its standard deviation, in every recording..."""
    alike: float = 1.0
    """...and the means differ by less than this multiple of it."""


@dataclass(frozen=True, kw_only=True)
class StructurePriorsSettings:
    """Settings of `vlab.diagnose.parameters.structure`."""

    step: float = 1e-3
    structure_sd: dict[str, float] = field(default_factory=lambda: {"tension": 0.05, "frequency": 0.003, "place": 1e-3})
    """The same of what only structures have, and how far a sensor may stand beside its point [m]. No mesh has every frequency to a part in a thousand (composites of 16 links miss by
    up to 0.2 % up to 50 Hz), and with damping ratios of a thousandth that is the width of a resonance."""
    of_fe_sd: float = 0.001
    """The same of frequencies that the plant has from the FE model, which misses a hundred-thousandth: what the twin, linear in all that
    is uncertain, misses of a plant that is some per cent off. With more room they take what belongs to stiffness and mass."""


@dataclass(frozen=True, kw_only=True)
class TermsSettings:
    """Settings of `vlab.diagnose.parameters.terms`."""

    unidentifiable: float = 1.0
    """Standard deviation of a size's logarithm beyond which it may as well be none."""
    nothing: float = 1e-3
    """A part of a law is nothing where it is this share of another one in its unit."""


@dataclass(frozen=True, kw_only=True)
class ProblemSettings:
    """Settings of `vlab.diagnose.problem`."""

    model_error: float = 0.002
    """Of a model that is integrated well: what the weights of fits allow for beside the noise."""
    integration_error: float = 5e-4
    """What integration leaves of a user's model where nothing is missing."""
    mesh_own_error: float = 0.005
    """What a structure's mesh and the places of its sensors leave after a refit, in MuJoCo on recordings kept aside: on the beam .002 to .008
    of their rms where nothing was hidden, most under pulses. It is more than the weights allow for: these say what a fit should strive
    for, this what its success is worth."""
    long: float = 0.9
    """Less than this share of a recording searched is worth saying."""


LOCATIONS = LocationsSettings()
MESH_CORRECTION = MeshCorrectionSettings()
MJCF_PRIORS = MjcfPriorsSettings()
MODE_SELECTION = ModeSelectionSettings()
OBSERVATION = ObservationSettings()
RECORDED_RUNS = RecordedRunsSettings()
REDUCED_MODEL = ReducedModelSettings()
STATIC_OFFSET = StaticOffsetSettings()
STRUCTURE_PRIORS = StructurePriorsSettings()
TERMS = TermsSettings()
PROBLEM = ProblemSettings()
