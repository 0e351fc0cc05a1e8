"""Kinds of channels and uncertain quantities, and their units."""

from vlab import units
from vlab.errors import BadCase, BadUnit, unknown_name
from vlab.signals import KIND_UNITS

UNCERTAIN_KINDS = (
    "stiffness",
    "damping",
    "friction",
    "mass",
    "armature",
    "inertia",
    "centre-of-mass",
    "length",
    "tension",
    "frequency",
    "gain",
    "velocity-gain",
    "sensor",
    "place",
    "delay",
)
"""Kinds of uncertain quantities in a model. A particular quantity has a name of the form type:name:quantity."""


HELD_KINDS = ("command", "voltage", "current")
"""Kinds of input that a converter holds between samples; every other kind is sampled from a smooth signal."""


OTHER_WORDS = {
    "torque": ("moment",),
    "position": ("displacement", "angle"),
    "speed": ("velocity", "angular-velocity"),
    "rotation": ("angle",),
    "angular-rate": ("angular-velocity",),
    "angular-position": ("angle",),
    "angular-displacement": ("angle",),
}
"""Words of other programs for kinds of channels, with candidate kinds; the unit decides."""


def check_unit(unit: str, si: str) -> None:
    """Refuse an unknown unit or one of another dimension."""
    units.factor(unit, si)


def known_kind(word: str, unit: str) -> str:
    """Return the kind of channel that a word means.

    Blanks, underscores and words of other programs are accepted.

    Parameters
    ----------
    word : str
        Kind as written.
    unit : str
        Unit of the channel, which resolves ambiguous words.

    Returns
    -------
    str
        Kind of channel.

    Raises
    ------
    UnknownName
        No such kind.
    BadCase
        The word has several meanings and the unit leaves them open.
    """
    word = word.strip().lower().replace(" ", "-").replace("_", "-")
    if word in KIND_UNITS:
        return word
    if word not in OTHER_WORDS:
        raise unknown_name("kind of channel", word, KIND_UNITS)
    meant = OTHER_WORDS[word]
    fitting = [k for k in meant if unit and units.same_dimension(unit, KIND_UNITS[k] or unit)]
    if len(meant) > 1 and len(fitting) != 1:
        raise BadCase(f"kind {word!r} may be {' or '.join(map(repr, meant))}; say which, or give the unit")
    return fitting[0] if fitting else meant[0]


def check_unit_of_kind(unit: str, kind: str, si: str) -> None:
    """Refuse a unit that does not fit the channel's kind.

    The message names the kind that the unit fits.
    """
    try:
        check_unit(unit, si)
    except BadUnit as error:
        meant = [k for k, own in KIND_UNITS.items() if own not in (None, "1") and units.same_dimension(unit, own)]
        if not meant:
            raise
        raise BadUnit(f"{error}; with this unit the kind is {' or '.join(map(repr, meant))}, not {kind!r}") from error
