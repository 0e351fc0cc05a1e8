"""The catalogue of effects and a figure for each, from the effects themselves: an effect that is added appears without a change here."""

import io
import logging
from typing import Any

import matplotlib as mpl
import mkdocs_gen_files
import numpy as np
from matplotlib.figure import Figure

from vlab.cli.effects import REFERENCES, places_of
from vlab.files.text import as_sentence
from vlab.physics.catalogue import ALIASES, EFFECTS
from vlab.physics.effect import (
    ActuatorEffect,
    Effect,
    LinearPortEffect,
    Parameter,
    PickUp,
    PortEffect,
    SensorEffect,
    Step,
)
from vlab.physics.servo import Servo, ServoEffect, at_servo
from vlab.signals import Array

PAGE = "reference/effects.md"
KINDS = {
    "port": "Effects at ports: forces along a coordinate of the structure",
    "actuator": "Effects of actuators: from the command to the force",
    "sensor": "Effects of sensors: from the motion to the recorded sample",
}
GREY, BLUE, RED = "#9a9a9a", "#1f5fa8", "#c44e1a"
CYCLES, PER_CYCLE = 4, 2000
"""Cycles of the motion that a port's figure is made of, and samples of each; the last two cycles are drawn."""
OWN_STIFFNESS = 1.0
"""Stiffness of the elastic element at the port [N/mm in the figures' units]."""
SERVO = Servo(gain=1.0, damping=0.05, limits=(-1.5, 1.5), inertia=0.002, drag=0.02)
"""Servo of the figures: gains in N/mm and N s/mm, limits in N, inertia in N s^2/mm, damping of the joint in N s/mm."""
SIGNAL_SAMPLES = 120
"""Samples of the command or motion that figures of actuators and sensors show, 1 s long."""
CHOSEN = {
    ("actuator-clipping", "limit"): 0.6,
    ("sensor-clipping", "limit"): 0.6,
    ("sensor-soft-saturation", "limit"): 0.9,
    ("soft-saturation", "limit"): 0.6,
    ("actuator-quantisation", "step"): 0.25,
    ("actuator-hold", "period"): 8.0,
    ("actuator-jitter", "jitter"): 6.0,
    ("actuator-delay", "delay"): 0.042,
    ("sensor-delay", "delay"): 0.042,
    ("actuator-lag", "time_constant"): 0.05,
    ("sensor-lag", "time_constant"): 0.05,
    ("sensor-high-pass", "time_constant"): 20.0,
    ("sensor-resonance", "frequency"): 8.0,
    ("sensor-resonance", "damping_ratio"): 0.05,
    ("actuator-gain", "gain"): -0.3,
    ("sensor-gain", "gain"): -0.3,
    ("mains-hum", "frequency"): 50.0,
    ("lugre-friction", "bristle"): 0.06,
    ("stop", "gap"): 0.6,
    ("dead-band", "gap"): 0.4,
    ("servo-error-dead-zone", "threshold"): 0.3,
    ("servo-force-limit", "limit"): 0.6,
    ("servo-soft-force-limit", "limit"): 0.6,
    ("servo-torque-speed-line", "limit"): 0.8,
    ("servo-torque-speed-line", "speed"): 1.2,
    ("sinusoidal-force", "frequency"): 3.0,
    ("attached-oscillator", "frequency"): 1.3,
    ("attached-oscillator", "damping_ratio"): 0.25,
    ("iwan-slip", "limit"): 1.0,
    ("actuator-hysteresis", "limit"): 1.0,
    ("slew-limit", "slope"): 0.1,
    ("rate-limit", "slope"): 0.1,
    ("stribeck-friction", "speed"): 0.2,
    ("sensor-quantisation", "step"): 0.25,
    ("structural-damping", "centre"): 1.0,
}
"""Values, in multiples of the parameter's reference where it has one, that show more than a value of the screening's grid would."""
SHARES = {"share": 0.4, "offset": 0.3, "rate": 0.5, "sine": 0.25, "cosine": 0.0, "gain": -0.3}
"""Amplitudes of actuator and sensor effects in units of the figures' signals."""


# ---- port effects -----------------------------------------------------------------------------------------------------


def shape(effect: Effect, parameter: Parameter, unit: float) -> float:
    """Return the value of a shape parameter that the figure shows; `unit` is what its reference is in the figure."""
    value = CHOSEN.get((effect.name, parameter.name))
    if value is None:
        grid = parameter.grid or (float(np.sqrt(parameter.low * parameter.high)),)
        value = grid[max(len(grid) - 2, 0)]
    return float(value) * (unit if parameter.reference else 1.0)


def motion() -> tuple[Array, Array, Array, Array]:
    """Return time [s], displacement [mm], velocity [mm/s] and acceleration [mm/s^2] of a vibration of 1 Hz and 1 mm."""
    t = np.arange(CYCLES * PER_CYCLE) / PER_CYCLE
    w = 2 * np.pi
    return t, np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)


def port_force(effect: PortEffect | LinearPortEffect, values: dict[str, float], command: Array) -> Array:
    """Return the force of an effect over the whole motion."""
    t, z, v, a = motion()
    if isinstance(effect, LinearPortEffect):
        m, c, k = effect.impedance(values, OWN_STIFFNESS)
        return np.asarray(-(m * a + c * v + k * z))
    memory, out, h = effect.memory(()), np.empty(len(t)), 1.0 / PER_CYCLE
    for i in range(len(t)):
        step = Step(h, t=float(t[i]), mobility=1e-3, command=float(command[i]))
        force, memory = effect.force(float(z[i]), float(v[i]), values, step, memory)
        out[i] = force
    return out


def port_figure(effect: PortEffect | LinearPortEffect) -> tuple[Figure, str]:
    """Draw force over displacement and over velocity, or over time where the law depends on that; and say what is shown."""
    t, z, v, _ = motion()
    units = {"displacement": 1.0, "velocity": 2 * np.pi, "input": 1.0, "": 1.0, "step": 1.0 / PER_CYCLE}
    units |= {"error": 1.0, "servo-force": 1.0, "servo-gain": 1.0}
    values = {p.name: shape(effect, p, units.get(p.reference, 1.0)) for p in effect.shapes}
    command = np.zeros(len(t)) if isinstance(effect, ServoEffect) else np.ones(len(t))
    for p in effect.amplitudes:  # each with a force of its own of about one newton
        alone = {**values, **{q.name: 0.0 for q in effect.amplitudes}, p.name: 1.0}
        size = float(np.max(np.abs(port_force(effect, alone, command))))
        values[p.name] = (1.0 if size == 0.0 else 1.0 / size) * (1.0 if p is effect.amplitudes[0] else 0.6)
    force = port_force(effect, values, command)
    shown = slice((CYCLES - 2) * PER_CYCLE, None)
    if "coil" in effect.needs:
        force = 1.0 + force
    is_of_time = isinstance(effect, PortEffect) and (
        effect.response == "none" or effect.lasts or effect.family == "time-variation"
    )
    figure = Figure(figsize=(6.4, 2.3), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.plot(z if is_of_time else z[shown], force if is_of_time else force[shown], color=BLUE, lw=1.6)
    left.set_xlabel("displacement z, mm")
    left.set_ylabel("force F, N")
    if is_of_time:
        right.plot(t, force, color=BLUE, lw=1.6)
        right.set_xlabel("time t, s")
    else:
        right.plot(v[shown], force[shown], color=BLUE, lw=1.6)
        right.set_xlabel("velocity v, mm/s")
    for axes in (left, right):
        axes.axhline(0.0, color=GREY, lw=0.6)
        axes.axvline(0.0, color=GREY, lw=0.6)
    if "coil" in effect.needs:
        return figure, "Force of the coil under a constant command of 1 N and a vibration of 1 Hz and 1 mm."
    if isinstance(effect, ServoEffect):
        return figure, "Change of a servo's force under a command of zero and a vibration of 1 Hz and 1 mm."
    what = "displacement and time" if is_of_time else "displacement and velocity"
    return figure, f"Force over {what} under a vibration of 1 Hz and 1 mm."


# ---- effects of actuators and sensors ---------------------------------------------------------------------------------


def test_signal(t: Array) -> Array:
    """Return a signal of size 1 with slow and fast parts and a jump."""
    y = np.sin(2 * np.pi * 1.5 * t) + 0.25 * np.sin(2 * np.pi * 5.0 * t) + np.where((t > 0.55) & (t < 0.75), 0.5, 0.0)
    return np.asarray(y / np.max(np.abs(y)))


def loop_figure(effect: ActuatorEffect) -> tuple[Figure, str]:
    """Draw force over command in cycles of growing level, and both over time; and say what is shown."""
    t = np.arange(4 * PER_CYCLE + 1) / PER_CYCLE
    u = np.sin(2 * np.pi * t) * np.minimum(np.floor(t) + 1.0, 4.0) / 4.0
    values = {p.name: shape(effect, p, 1.0) for p in effect.shapes} | {p.name: 0.6 for p in effect.amplitudes}
    force = effect.actuate(u, values, 1.0 / PER_CYCLE)
    figure = Figure(figsize=(6.4, 2.3), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.plot(u, force, color=BLUE, lw=1.2)
    left.set_xlabel("command u / its largest value")
    left.set_ylabel("force / largest command")
    right.plot(t, u, color=GREY, lw=1.4, label="command u")
    right.plot(t, force, color=BLUE, lw=1.4, label="force")
    right.set_xlabel("time / period")
    right.legend(loc="upper left", frameon=False, fontsize=7)
    for axes in (left, right):
        axes.axhline(0.0, color=GREY, lw=0.6)
    return figure, "Force over command and over time, in cycles of growing level."


def signal_figure(effect: ActuatorEffect | SensorEffect) -> tuple[Figure, str]:
    """Draw a signal before and behind the effect over time; and say what is shown."""
    h = 1.0 / SIGNAL_SAMPLES if effect.name != "mains-hum" else 1.0 / 1000.0
    t = np.arange(round(1.0 / h)) * h
    x = test_signal(t)
    units = {"input": 1.0, "output": 1.0, "step": h, "input-slope": float(np.max(np.abs(np.diff(x)))) / h}
    values = {p.name: shape(effect, p, units.get(p.reference, 1.0)) for p in effect.shapes}
    values |= {p.name: SHARES.get(p.name, 0.3) for p in effect.amplitudes}
    figure = Figure(figsize=(6.4, 2.3), layout="constrained")
    axes = figure.subplots()
    is_actuator = isinstance(effect, ActuatorEffect)
    before = "command u" if is_actuator else "motion x"
    after = "force" if is_actuator else "reading y"
    steps = "steps-post" if effect.family in ("timing", "resolution") or effect.name == "rate-limit" else "default"
    axes.plot(t, x, color=GREY, lw=1.4, label=before, drawstyle=steps)
    if isinstance(effect, PickUp):
        other = np.sign(np.sin(2 * np.pi * 2.5 * t + 0.3))
        y = np.asarray(effect.mix(x, other, values))
        axes.plot(
            t, other, color=RED, lw=0.8, ls=":", label="command u" if "command" in effect.needs else "other motion x2"
        )
    else:
        y = effect.actuate(x, values, h) if isinstance(effect, ActuatorEffect) else effect.sense(x, values, h, t)
    axes.plot(t, y, color=BLUE, lw=1.4, label=after, drawstyle=steps)
    axes.set_xlabel("time, s")
    axes.set_ylabel("signal / its largest value")
    axes.legend(loc="upper right", frameon=False, fontsize=7, ncols=3)
    axes.set_ylim(-1.75, 1.75)
    return figure, f"{'Force' if is_actuator else 'Reading'} beside the {before.split()[0]} over time."


# ---- the page ---------------------------------------------------------------------------------------------------------


def svg(figure: Figure) -> str:
    """Return a figure as SVG, the same from build to build."""
    text = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "vlab", "svg.fonttype": "path"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def draw(effect: Effect) -> tuple[Figure, str]:
    """Draw the figure of an effect."""
    with mpl.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        if isinstance(effect, ServoEffect):
            effect = at_servo(effect, SERVO)
        if isinstance(effect, (PortEffect, LinearPortEffect)):
            return port_figure(effect)
        assert isinstance(effect, (ActuatorEffect, SensorEffect))
        if isinstance(effect, ActuatorEffect) and effect.family == "input-hysteresis":
            return loop_figure(effect)
        return signal_figure(effect)


def parameter_row(p: Parameter) -> str:
    """Return the row of a parameter in its table."""

    def number(x: float) -> str:
        if x == 0.0 or 1e-3 <= abs(x) < 1e4:
            return np.format_float_positional(x, trim="-")
        return f"{x:.0e}".replace("e-0", "e-").replace("e+0", "e")

    of = f" × {REFERENCES[p.reference]}" if p.reference else f" {p.unit}" if p.unit != "1" else ""
    sign = "±" if p.signed and p.low > 0 else ""
    bounds = f"{number(p.low)} to {number(p.high)}"
    return f"| `{p.name}` | {p.unit} | {f'{sign}({bounds})' if sign else bounds}{of} | {p.words} |"


def section(effect: Effect) -> str:
    """Return the section of an effect."""
    figure, caption = draw(effect)
    with mkdocs_gen_files.open(f"reference/effects/{effect.name}.svg", "w") as file:
        file.write(svg(figure))
    also = [f"`{alias}`" for alias, name in ALIASES.items() if name == effect.name]
    lines = [
        f"### {effect.name}", "",
        as_sentence(effect.words), "",
        f"Law: `{effect.law}`", "",
        f"- Family: {effect.family}.",
        f"- Places: {places_of(effect)}.",
    ]  # fmt: skip
    if effect.form_of:
        lines.append(f"- Form of [{effect.form_of}](#{effect.form_of}). Reports use the name `{effect.form_of}`.")
    if also:
        lines.append(f"- Other names: {', '.join(also)}.")
    lines += ["", "| parameter | unit | prior range | meaning |", "|---|---|---|---|"]
    lines += [parameter_row(p) for p in effect.parameters]
    lines += ["", f"![{caption}](effects/{effect.name}.svg){{ .effect loading=lazy }}", "", f"*{caption}*", ""]
    return "\n".join(lines)


def overview() -> str:
    """Return the table of all effects by family."""
    families: dict[str, list[Effect]] = {}
    for effect in EFFECTS.values():
        families.setdefault(effect.family, []).append(effect)
    rows = [
        f"| {family} | {', '.join(f'[{e.name}](#{e.name})' for e in effects)} |" for family, effects in families.items()
    ]
    return "\n".join(["| family | effects |", "|---|---|", *rows, ""])


HEAD = f"""# Catalogue of effects

This page and its figures are generated from the code of the {len(EFFECTS)} effects. `vlab effects` prints the
catalogue as a table. `vlab effects NAME` prints one entry.

An effect has one law. The same law serves MuJoCo simulation, the fits of a diagnosis and the screening.
[Theory of the bench](../theory/bench.md#effects) describes how a law enters a simulation.

Units are those of a translation. At a rotation, read N as N m and m as rad. For an actuator, N stands for the unit of
the command. For a sensor, m stands for the unit of the channel.

The prior range bounds a parameter in a diagnosis. `±` marks a parameter that may be negative.

An effect in a command or in a plan has the form `NAME@PLACE:parameter=value,parameter=value`. An example is
`coulomb-friction@40in:force=0.005lbf`.
"""


def main() -> None:
    """Write the page and its figures."""
    logging.getLogger("matplotlib").setLevel(logging.WARNING)
    text = HEAD + "\n" + overview() + "\n"
    for kind, title in KINDS.items():
        text += f"## {title}\n\n" + "\n".join(section(e) for e in EFFECTS.values() if e.kind == kind) + "\n"
    with mkdocs_gen_files.open(PAGE, "w") as page:
        page.write(text)


_: Any = main()
