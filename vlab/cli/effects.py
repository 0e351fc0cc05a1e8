"""``vlab effects``."""

import argparse
from typing import Any

from vlab.cli.common import Outcome
from vlab.controllers.user_law import code_of
from vlab.physics.catalogue import ALIASES, EFFECTS, effect_named
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="show these effects, or your own as FILE.py:CLASS (default all)"
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """List the catalogue of physics that a model can lack."""
    wanted = [effect_named(name, code=[code_of(name)]) for name in arguments.names] or list(EFFECTS.values())
    document = [_plain(effect) for effect in wanted]
    return Outcome(document=document, text="\n\n".join(_text(entry) for entry in document))


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
        of = f" x the largest {p['in_multiples_of']}" if p["in_multiples_of"] else f" {p['unit']}"
        words = f"; {p['words']}" if p["words"] else ""
        lines.append(f"  {p['name']} [{p['unit']}]: {p['low']:g} to {p['high']:g}{of}{words}")
    return "\n".join(lines)
