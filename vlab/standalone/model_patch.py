"""Changes of a compiled model as edits of its text.

The nominal and the wanted compiled model are compared number by number. Each difference is an attribute of a joint, a
tendon, an actuator, a position or a body's inertia. New fixed tendons are elements at the end of the tendon section.
"""

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from vlab.signals import Array
from vlab.standalone.mjcf_text import Element, ModelText, escaped
from vlab.standalone.positions import POSITIONS, moved_text, tendon_lengths

DIGITS = 10
"""DIGITS [1]: significant digits of a written number. Parameters are known to three or four; the rest keeps the written
model equal to the computed one to 1e-9."""
_SHARED = {
    "stiffness": ("{0}_stiffness", "{0}_stiffnesspoly"),
    "damping": ("{1}_damping", "{1}_dampingpoly"),
    "armature": ("{1}_armature",),
    "frictionloss": ("{1}_frictionloss",),
}
JOINT = {k: tuple(f.format("jnt", "dof") for f in v) for k, v in _SHARED.items()} | {
    "solreffriction": ("dof_solref",),
    "solimpfriction": ("dof_solimp",),
}
TENDON = {k: tuple(f.format("tendon", "tendon") for f in v) for k, v in _SHARED.items()} | {
    "solreffriction": ("tendon_solref_fri",),
    "solimpfriction": ("tendon_solimp_fri",),
}
"""Fields of the compiled model by attribute; a second field holds the higher powers."""
INERTIA = ("body_mass", "body_ipos", "body_iquat", "body_inertia")
ACTUATOR = (
    "actuator_gainprm", "actuator_biasprm", "actuator_dynprm", "actuator_ctrlrange", "actuator_ctrllimited",
    "actuator_biastype", "actuator_dyntype", "actuator_actearly", "actuator_delay",
    "actuator_forcerange", "actuator_forcelimited",
)  # fmt: skip
NUMBERS = tuple(
    dict.fromkeys(
        f for table in (JOINT, TENDON) for fields in table.values() for f in fields
    )
) + INERTIA + ACTUATOR[:5] + ACTUATOR[-2:] + (*POSITIONS.values(), "tendon_lengthspring")  # fmt: skip
"""Numbers that a law module can set in the compiled model where the text cannot."""
_DYNTYPE = {0: "none", 1: "integrator", 2: "filter", 3: "filterexact"}
_OF_SHORTCUTS = ("kp", "kv", "dampratio", "timeconst", "inheritrange")
_INPUTS = {"motor": {}, "position": {"input": "pos"}, "velocity": {"input": "vel"}}
"""Shortcuts that can become general actuators, with the attributes that they imply."""


@dataclass(frozen=True, kw_only=True)
class Changed:
    """A changed attribute of an element.

    Parameters
    ----------
    element : str
        Kind and name, ``joint:elbow``.
    attribute : str
        Attribute of the text.
    before, after : str
        Nominal and new value of the compiled model; "" for none.
    """

    element: str
    attribute: str
    before: str
    after: str


@dataclass(kw_only=True)
class ModelPatch:
    """Edits of a model's text.

    Parameters
    ----------
    text : ModelText
        Text with its edits.
    changes : list of Changed
        Changed attributes.
    lost : list of str
        Elements that are not in the text, such as those of ``replicate`` and ``attach``.
    """

    text: ModelText
    changes: list[Changed] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)


def number_text(values: Any) -> str:
    """Return numbers as the value of an attribute, without trailing zeros.

    Parameters
    ----------
    values : array_like
        Numbers.

    Returns
    -------
    str
        At least one number.
    """
    every = [float(x) for x in np.ravel(values)]
    while len(every) > 1 and every[-1] == 0.0:
        every.pop()
    return _all_text(every)


def _all_text(values: Any) -> str:
    return " ".join(f"{float(x) + 0.0:.{DIGITS}g}" for x in np.ravel(values))


def patched(text: ModelText, nominal: Any, wanted: Any, *, can_rename: bool = True) -> ModelPatch:
    """Edit a model's text so that the text compiles to another model.

    Parameters
    ----------
    text : ModelText
        Text of the nominal model; receives the edits.
    nominal, wanted : mujoco.MjModel
        Compiled models; `wanted` may have more tendons, at the end.
    can_rename : bool
        Whether a shortcut such as ``motor`` may become ``general``.

    Returns
    -------
    ModelPatch
        Text and changes.
    """
    out, found = ModelPatch(text=text), _Elements(text)
    for i in range(nominal.njnt):
        rows = {"jnt": i, "dof": int(nominal.jnt_dofadr[i])}
        element = found.find("joint", nominal.joint(i).name, i, nominal.njnt)
        _set_numbers(out, element, f"joint:{nominal.joint(i).name or i}", JOINT, rows, (nominal, wanted))
    for i in range(nominal.ntendon):
        element = found.find("tendon", nominal.tendon(i).name, i, nominal.ntendon)
        _set_numbers(out, element, f"tendon:{nominal.tendon(i).name or i}", TENDON, {"tendon": i}, (nominal, wanted))
    with_moved_geoms = _set_positions(out, found, nominal, wanted)
    for i in range(1, nominal.nbody):
        if i in with_moved_geoms or any(_differs(getattr(nominal, f)[i], getattr(wanted, f)[i]) for f in INERTIA):
            element = found.find("body", nominal.body(i).name, i - 1, nominal.nbody - 1)
            element = element if found.has_own_inertias else None
            _set_inertia(out, element, f"body:{nominal.body(i).name or f'body{i}'}", i, (nominal, wanted))
    for i in range(nominal.nu):
        if any(_differs(getattr(nominal, f)[i], getattr(wanted, f)[i]) for f in ACTUATOR):
            element = found.find("actuator", nominal.actuator(i).name, i, nominal.nu)
            label = f"actuator:{nominal.actuator(i).name or i}"
            _set_actuator(out, element, label, i, (nominal, wanted), can_rename=can_rename)
    _add_tendons(out, nominal, wanted)
    return out


class _Elements:
    """Elements of a model's text by kind."""

    def __init__(self, text: ModelText) -> None:
        every = list(text.root.iterate())
        self.is_plain = not any(e.tag in ("replicate", "attach", "composite", "flexcomp") for e in every)
        sections = text.root.children
        compilers = [e.attributes for e in sections if e.tag == "compiler"]
        self.is_fused = any(c.get("fusestatic") == "true" for c in compilers)
        self.has_own_inertias = not self.is_fused and not any(
            c.get("inertiafromgeom") == "true" or "settotalmass" in c for c in compilers
        )
        """Whether MuJoCo takes inertial elements as written."""
        self.placed_by_default = {
            e.tag
            for section in sections
            if section.tag == "default"
            for e in section.iterate()
            if e.attributes.keys() & {"pos", "fromto"}
        }
        """Kinds of elements whose position may come from a default."""
        worlds = [e for e in sections if e.tag == "worldbody"]
        bodies = [e for world in worlds for e in world.iterate() if e.tag == "body"]
        self.kinds: dict[str, list[Element]] = {
            "body": bodies,
            "joint": [j for body in bodies for j in _parts_of(body, ("joint", "freejoint"))],
            "site": _of_world_and_bodies(worlds, bodies, "site"),
            "geom": _of_world_and_bodies(worlds, bodies, "geom"),
            "tendon": [e for section in sections if section.tag == "tendon" for e in section.children],
            "actuator": [e for section in sections if section.tag == "actuator" for e in section.children],
        }

    def find(self, kind: str, name: str, index: int, count: int) -> Element | None:
        """Return an element by name, or by its number.

        A number counts only where all elements of the kind are in the text.

        Returns
        -------
        Element or None
            None if the element is not in the text.
        """
        every = self.kinds[kind]
        if name:
            named = [e for e in every if e.attributes.get("name") == name]
            return named[0] if len(named) == 1 else None
        return every[index] if self.is_plain and len(every) == count else None


def _parts_of(body: Element, tags: tuple[str, ...]) -> list[Element]:
    """Return the elements of a body's own, in MuJoCo's order."""
    out = []
    for child in body.children:
        if child.tag in tags:
            out.append(child)
        elif child.tag == "frame":
            out += _parts_of(child, tags)
    return out


def _of_world_and_bodies(worlds: list[Element], bodies: list[Element], tag: str) -> list[Element]:
    return [part for body in (*worlds, *bodies) for part in _parts_of(body, (tag,))]


def _differs(a: Any, b: Any) -> bool:
    return not np.array_equal(a, b)


def _set_numbers(
    out: ModelPatch,
    element: Element | None,
    label: str,
    table: dict[str, tuple[str, ...]],
    rows: dict[str, int],
    models: tuple[Any, Any],
) -> None:
    """Set the attributes of a joint or tendon."""
    new: dict[str, str | None] = {}
    for attribute, fields in table.items():
        before, after = (
            np.concatenate([np.ravel(getattr(m, f)[rows[f.partition("_")[0]]]) for f in fields]) for m in models
        )
        if _differs(before, after):
            new[attribute] = number_text(after)
            out.changes.append(
                Changed(element=label, attribute=attribute, before=number_text(before), after=number_text(after))
            )
    if new and (element is None or element.tag == "freejoint"):
        out.lost.append(label)
    elif new and element is not None:
        out.text.set(element, new)


def _set_positions(out: ModelPatch, found: _Elements, nominal: Any, wanted: Any) -> set[int]:
    """Move parts of the model, and return the bodies of moved geoms.

    A spatial tendon without a stated spring length would take its length in the moved model, so the length is stated.
    """
    of_geoms, has_moved = set(), False
    for kind, field_name in POSITIONS.items():
        before, after = getattr(nominal, field_name), getattr(wanted, field_name)
        first = 1 if kind == "body" else 0  # the world has no element
        for i in range(first, len(before)):
            if not _differs(before[i], after[i]):
                continue
            has_moved = True
            name = getattr(nominal, kind)(i).name
            of_geoms |= {int(nominal.geom_bodyid[i])} if kind == "geom" else set()
            element = found.find(kind, name, i - first, len(before) - first)
            label = f"{kind}:{name or i}"
            new = None
            if element is not None and not found.is_fused:
                new = moved_text(element, after[i] - before[i], is_placed_by_default=kind in found.placed_by_default)
            if element is None or new is None:
                out.lost.append(label)
                continue
            out.text.set(element, {k: _all_text(v) for k, v in new.items()})
            out.changes.append(
                Changed(element=label, attribute="pos", before=_all_text(before[i]), after=_all_text(after[i]))
            )
    for i in tendon_lengths(nominal, wanted) if has_moved else ():
        element = found.find("tendon", nominal.tendon(i).name, i, nominal.ntendon)
        if element is not None:
            low, high = wanted.tendon_lengthspring[i]
            out.text.set(element, {"springlength": _all_text(low if low == high else (low, high))})
    return of_geoms


def _set_inertia(out: ModelPatch, element: Element | None, label: str, i: int, models: tuple[Any, Any]) -> None:
    """Set a body's mass, centre and moments of inertia."""
    nominal, wanted = models
    mass, moments = _all_text(wanted.body_mass[i]), _all_text(wanted.body_inertia[i])
    out.changes.append(Changed(element=label, attribute="mass", before=_all_text(nominal.body_mass[i]), after=mass))
    if _differs(nominal.body_inertia[i], wanted.body_inertia[i]):
        out.changes.append(
            Changed(element=label, attribute="diaginertia", before=_all_text(nominal.body_inertia[i]), after=moments)
        )
    if element is None:
        out.lost.append(label)
        return
    own = next((child for child in element.children if child.tag == "inertial"), None)
    only_mass = not any(_differs(getattr(nominal, f)[i], getattr(wanted, f)[i]) for f in INERTIA[1:])
    if own is not None and only_mass:
        out.text.set(own, {"mass": mass})
        return
    place = {"pos": _all_text(wanted.body_ipos[i]), "quat": _all_text(wanted.body_iquat[i])}
    if own is None:
        if place["quat"] == "1 0 0 0":
            del place["quat"]
        values = {**place, "mass": mass, "diaginertia": moments}
        out.text.add(element, _tag("inertial", values), is_first=True)
        return
    same_place = not any(_differs(getattr(nominal, f)[i], getattr(wanted, f)[i]) for f in ("body_ipos", "body_iquat"))
    if same_place and "fullinertia" not in own.attributes:
        out.text.set(own, {"mass": mass, "diaginertia": moments})
        return
    gone = dict.fromkeys(("fullinertia", "axisangle", "xyaxes", "zaxis", "euler"))
    out.text.set(own, {**gone, **place, "mass": mass, "diaginertia": moments})


def _set_actuator(
    out: ModelPatch, element: Element | None, label: str, i: int, models: tuple[Any, Any], *, can_rename: bool
) -> None:
    """Set gains, limits, delay and filter of an actuator."""
    nominal, wanted = models
    new: dict[str, str | None] = {}
    tag = ""
    if element is None:
        out.lost.append(label)
    changed = {f for f in ACTUATOR if _differs(getattr(nominal, f)[i], getattr(wanted, f)[i])}
    if changed & {"actuator_ctrlrange", "actuator_ctrllimited"}:
        new |= {"ctrllimited": "true", "ctrlrange": _all_text(wanted.actuator_ctrlrange[i])}
    if changed & {"actuator_forcerange", "actuator_forcelimited"}:
        new |= {"forcelimited": "true", "forcerange": _all_text(wanted.actuator_forcerange[i])}
    if "actuator_delay" in changed:
        samples = int(wanted.actuator_history[i][0])
        new |= {"nsample": str(samples), "interp": "linear", "delay": _all_text(wanted.actuator_delay[i])}
    parameters = changed & set(ACTUATOR[:3]) | changed & {"actuator_biastype", "actuator_dyntype", "actuator_actearly"}
    if parameters and element is not None:
        is_braked = bool(nominal.actuator_biasprm[i, 2] != wanted.actuator_biasprm[i, 2])
        short = _shortcut(element, i, wanted, parameters, is_braked=is_braked)
        if short is None:
            if element.tag in _INPUTS and can_rename:
                tag = "general"
                new |= dict.fromkeys(_OF_SHORTCUTS) | _INPUTS[element.tag]
            if element.tag == "general" or tag:
                new |= _general(i, wanted, nominal, is_whole=bool(tag))
        else:
            new |= short
    for attribute, value in new.items():
        if value is not None:
            before = _before(nominal, i, attribute)
            out.changes.append(Changed(element=label, attribute=attribute, before=before, after=value))
    if element is not None:
        out.text.set(element, new, tag=tag)


def _before(nominal: Any, i: int, attribute: str) -> str:
    field = {"kp": "actuator_gainprm", "kv": "actuator_biasprm"}.get(attribute, f"actuator_{attribute}")
    if attribute == "kv" and nominal.actuator_biasprm[i, 2] != 0:
        return number_text(-nominal.actuator_biasprm[i, 2])
    if attribute in ("gainprm", "biasprm", "dynprm", "delay", "ctrlrange", "forcerange", "kp"):
        values = np.ravel(getattr(nominal, field)[i])
        return number_text(values[:1] if attribute == "kp" else values)
    return ""


def _shortcut(
    element: Element, i: int, wanted: Any, changed: set[str], *, is_braked: bool
) -> dict[str, str | None] | None:
    """Return the attributes of a servo's shortcut, or None.

    A changed velocity feedback (`is_braked`) is stated even where the text leaves it to a default.
    """
    gain, bias = wanted.actuator_gainprm[i], wanted.actuator_biasprm[i]
    if changed - {"actuator_gainprm", "actuator_biasprm"} or np.any(gain[1:]) or np.any(bias[3:]) or bias[0] != 0:
        return None
    if element.tag == "position" and bias[1] == -gain[0]:
        out: dict[str, str | None] = {"kp": number_text(gain[0])}
        if is_braked or "kv" in element.attributes or "dampratio" in element.attributes:
            out |= {"kv": number_text(-bias[2]), "dampratio": None}
        return out
    if element.tag == "velocity" and bias[1] == 0 and bias[2] == -gain[0]:
        return {"kv": number_text(gain[0])}
    return None


def _general(i: int, wanted: Any, nominal: Any, *, is_whole: bool) -> dict[str, str | None]:
    """Return the attributes of a general actuator, all or the changed ones."""
    out: dict[str, str | None] = {}
    is_affine = wanted.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
    every = {
        "dyntype": _DYNTYPE.get(int(wanted.actuator_dyntype[i]), "none"),
        "dynprm": number_text(wanted.actuator_dynprm[i]),
        "gainprm": number_text(wanted.actuator_gainprm[i]),
        "biastype": "affine" if is_affine else "none",
        "biasprm": number_text(wanted.actuator_biasprm[i]),
    }
    usual = {"dyntype": "none", "dynprm": "1", "gainprm": "1", "biastype": "none", "biasprm": "0"}
    for attribute, value in every.items():
        before = _differs(getattr(nominal, f"actuator_{attribute}")[i], getattr(wanted, f"actuator_{attribute}")[i])
        if before or (is_whole and value != usual[attribute]):
            out[attribute] = value
    if wanted.actuator_actearly[i] != nominal.actuator_actearly[i]:
        out["actearly"] = "true" if wanted.actuator_actearly[i] else "false"
    return out


def _add_tendons(out: ModelPatch, nominal: Any, wanted: Any) -> None:
    """Add the springs of effects to the tendon section."""
    texts = []
    for i in range(nominal.ntendon, wanted.ntendon):
        values = {
            "name": wanted.tendon(i).name,
            "limited": "false",
            "springlength": _all_text(wanted.tendon_lengthspring[i]),
            "stiffness": number_text(wanted.tendon_stiffness[i]),
            "damping": "0",
            "frictionloss": "0",
            "armature": "0",
        }
        low, high = wanted.tendon_lengthspring[i]
        if low == high:
            values["springlength"] = _all_text(low)
        if wanted.tendon_springyield[i] > 0:
            values["springyield"] = number_text(wanted.tendon_springyield[i])
        first = int(wanted.tendon_adr[i])
        joints = [
            _tag(
                "joint", {"joint": wanted.joint(int(wanted.wrap_objid[w])).name, "coef": _all_text(wanted.wrap_prm[w])}
            )
            for w in range(first, first + int(wanted.tendon_num[i]))
        ]
        lines = [_tag("fixed", values).replace("/>", ">"), *(f"  {joint}" for joint in joints), "</fixed>"]
        texts.append("\n".join(lines))
        out.changes.append(
            Changed(element=f"tendon:{wanted.tendon(i).name}", attribute="", before="", after=values["stiffness"])
        )
    if not texts:
        return
    section = next((e for e in out.text.root.children if e.tag == "tendon" and e.file == out.text.path), None)
    if section is not None:
        for text in texts:
            out.text.add(section, text)
        return
    inner = "\n".join(f"  {line}" for text in texts for line in text.splitlines())
    out.text.add(out.text.root, f"<tendon>\n{inner}\n</tendon>")


def _tag(name: str, values: dict[str, str]) -> str:
    return f"<{name} " + " ".join(f'{k}="{escaped(v)}"' for k, v in values.items()) + "/>"


def differing(a: Any, b: Any) -> dict[str, Array]:
    """Return the fields of two compiled models that differ.

    Parameters
    ----------
    a, b : mujoco.MjModel
        Compiled models.

    Returns
    -------
    dict of str to array
        Mask of the differing numbers by field, () where shapes or sizes differ. Numbers agree to the written digits.
    """
    out: dict[str, Array] = {}
    for name in dir(a):
        one, two = getattr(a, name), getattr(b, name)
        if name.startswith("_") or not isinstance(one, (int, np.ndarray)) or name in ("nbuffer", "signature"):
            continue
        if np.shape(one) != np.shape(two):
            out[name] = np.array(True)
        elif isinstance(one, np.ndarray) and one.dtype.kind == "f":
            scale = float(np.abs(one).max(initial=0.0))
            mask = ~np.isclose(one, two, rtol=1e-8, atol=1e-10 * scale)
            if mask.any():
                out[name] = mask
        elif isinstance(one, np.ndarray) and one.dtype.kind in "iub" and not np.array_equal(one, two):
            out[name] = np.asarray(one != two)
    return out
