"""``vlab effects``."""

import argparse
from typing import Any

from vlab.cli.common import Outcome
from vlab.cli.table import text_table
from vlab.controllers.user_law import code_of
from vlab.errors import UnknownName, unknown_name
from vlab.physics.catalogue import ALIASES, EFFECT_FORM, EFFECTS, LAST_RESORT, effect_named, effects
from vlab.physics.effect import Effect

PLACES = {
    "port": "a point, joint, tendon, site or element",
    "actuator": "an actuator, or chain for all of them",
    "sensor": "a sensor or a compared channel",
}
NEEDS = {
    "stiffness": "with an elastic element of its own",
    "coil": "with an actuator along it",
    "magnet": "sought only with an actuator along it or without an elastic element of its own",
    "translation": "that moves along a line; a body",
    "rotation": "that turns",
    "tension": "tension: the stretched bar as a whole",
    "command": "with the coil that it picks up: sensor:20in/coil:base",
    "sensor": "with the other sensor: sensor:20in/40in",
}


SERVO = "an actuator that is a position servo of a joint or tendon: actuator:shoulder"
"""Places of effects within a servo's loop."""


REFERENCES = {
    "displacement": "largest displacement at the place",
    "travel": "half of the range of the displacement at the place, at most half a revolution",
    "velocity": "largest velocity at the place",
    "input": "largest command",
    "input-slope": "largest slope of the command",
    "output": "largest reading",
    "duration": "duration of the recording",
    "step": "sample period",
    "error": "largest position error of the servo",
    "servo-force": "largest force of the servo",
    "servo-gain": "position gain of the servo",
}
"""Scales of a parameter's range in words."""
SHORT = {"port": "point, joint, element", "actuator": "actuator", "sensor": "sensor", SERVO: "position servo"}
"""Places of an effect in the table."""
MOST_NAMED = 6
"""MOST_NAMED [1]: largest number of parameters of an effect in the table."""
TURNING = "At a joint that turns, read N m for N and rad for m."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="show these effects in full, or a family, or your own as FILE.py:CLASS (default: table of all)",
    )
    parser.add_argument(
        "--family", action="append", default=[], metavar="NAME", help="list this family only; may be repeated"
    )
    parser.add_argument("--full", action="store_true", help="show laws, places and parameters in full (default: table)")


def run(arguments: argparse.Namespace) -> Outcome:
    """List the catalogue of physics that a model can lack.

    Parameters
    ----------
    arguments : Namespace
        Parsed arguments of the command.

    Returns
    -------
    Outcome
        Document and text of the command.
    """
    known = [family for family in families() if family not in EFFECTS]
    asked = [*arguments.family, *(name for name in arguments.names if name in known)]
    of_families = [effect for family in dict.fromkeys(asked) for effect in effects(family)]
    names = [name for name in arguments.names if name not in known]
    wanted = of_families + [_named(name) for name in names]
    document = [_plain(effect) for effect in wanted or EFFECTS.values()]
    if names or arguments.full:
        return Outcome(document=document, text="\n\n".join(_text(entry) for entry in document))
    return Outcome(document=document, text=_table(document))


def families() -> list[str]:
    """Return the families of the catalogue in order."""
    return list(dict.fromkeys(effect.family for effect in EFFECTS.values()))


def _named(name: str) -> Effect:
    """Return an effect; the error on another name lists names and families."""
    if name in EFFECTS or name in ALIASES or code_of(name):
        return effect_named(name, code=[code_of(name)])
    within = [known for known in (*EFFECTS, *ALIASES) if name.lower() in known]
    if within:
        raise UnknownName(f"unknown effect {name!r}; names that contain it: {', '.join(within)}")
    raise unknown_name("effect or family", name, [*EFFECTS, *ALIASES, *families(), EFFECT_FORM])


def _parameters(entry: dict[str, Any]) -> str:
    names = [p["name"] for p in entry["parameters"]]
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _table(document: list[dict[str, Any]]) -> str:
    """Return the table of effects, with a line on details."""
    rows = [
        [entry["family"], entry["name"], SHORT.get(entry["places"], SHORT[entry["kind"]]), _parameters(entry)]
        for entry in document
    ]
    table = text_table(["family", "effect", "at", "parameters"], rows)
    first = document[0]["name"]
    tabulated = [effect.name for effect in LAST_RESORT if effect.name in [entry["name"] for entry in document]]
    count = len(rows) - len(tabulated)
    counted = " and ".join([f"{count} effect{'s' * (count != 1)}", *(f"the tabulated {name}" for name in tabulated)])
    asked = [entry["name"] for entry in document if entry["name"] in EFFECTS and EFFECTS[entry["name"]].is_on_request]
    searched = f"; a search tries {', '.join(asked)} on request only (--effect)" if asked else ""
    return f"{table}\n\n{counted}{searched}; law, places and ranges of one: vlab effects {first}"


def places_of(effect: Effect) -> str:
    """Return the places of an effect in words."""
    if "servo" in effect.needs:
        return SERVO
    return ", ".join([PLACES[effect.kind], *(NEEDS[need] for need in effect.needs)])


def _plain(effect: Effect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "also": [alias for alias, name in ALIASES.items() if name == effect.name],
        "form_of": effect.form_of,
        "family": effect.family,
        "kind": effect.kind,
        "law": effect.law,
        "places": places_of(effect),
        "parameters": [
            {
                "name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "in_multiples_of": p.reference,
                "may_be_negative": p.signed, "words": p.words,
            }
            for p in effect.parameters
        ],
        "words": effect.words,
    }  # fmt: skip


def _text(entry: dict[str, Any]) -> str:
    also = f"  (also {', '.join(entry['also'])})" if entry["also"] else ""
    form = f"  a form of {entry['form_of']}" if entry["form_of"] else ""
    lines = [f"{entry['name']}  [{entry['family']}]{also}{form}", f"  {entry['words']}", f"  {entry['law']}"]
    lines.append(f"  at: {entry['places']}")
    for p in entry["parameters"]:
        unit = "" if p["unit"] == "1" else f" {p['unit']}"
        of = f" x {REFERENCES[p['in_multiples_of']]}" if p["in_multiples_of"] else unit
        words = f"; {p['words']}" if p["words"] else ""
        lines.append(f"  {p['name']} [{p['unit']}]: {p['low']:g} to {p['high']:g}{of}{words}")
    if entry["kind"] == "port" and any("N" in p["unit"] or "m" in p["unit"] for p in entry["parameters"]):
        lines.append(f"  {TURNING}")
    return "\n".join(lines)
