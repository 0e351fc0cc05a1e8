"""Two small rigs with MJCF models: belt-driven slider and shaft.

The equations of motion are masses on springs. The MJCF is text for the case and is not read here.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vlab.proof.generator.bench import Bench, Benign, Blueprint, Place, Sensor
from vlab.proof.generator.statement import COLOURED, STRAY, WRONG, stated
from vlab.signals import Array

STATED: dict[str, tuple[float, ...]] = {
    "stiffness": (0.02, 0.03, 0.05),
    "mass": (0.01, 0.02, 0.05),
    "damping": (0.2, 0.3, 0.5),
    "gain": (0.01, 0.02, 0.05),
    "sensor": (0.005, 0.01),
}
"""STATED [-]: round standard deviations that a varied case states, by kind."""
INTEGRATORS, TIMESTEPS = {"RK4": 0.6, "implicitfast": 0.4}, (0.001, 0.002)
"""INTEGRATORS, TIMESTEPS [s]: integrators of the nominal model of a varied case with their frequencies, and steps."""
SD = {"stiffness": 0.03, "mass": 0.02, "damping": 0.2, "gain": 0.02, "sensor": 0.005}
"""SD [-]: relative standard deviations of the built parameters, stated by the case."""


class _Chain(NamedTuple):
    """Bodies in a row with inertias, springs, dampers and couplings."""

    bodies: tuple[str, ...]
    inertia: tuple[float, ...]
    ground: tuple[tuple[float, float], ...]  # stiffness and damping to ground of each body
    couplings: tuple[str, ...]
    coupling: tuple[tuple[float, float], ...]  # stiffness and damping between neighbours
    motors: Mapping[str, str]  # name to body
    seen: Mapping[str, str]  # sensor name to body
    angular: bool
    order: int


SLIDER = _Chain(
    bodies=("drive", "carriage", "payload"),
    inertia=(0.8, 2.4, 0.6),
    ground=((900.0, 3.0), (0.0, 4.0), (0.0, 0.0)),
    couplings=("belt", "bracket"),
    coupling=((6000.0, 3.0), (3500.0, 1.2)),
    motors={"motor": "drive", "shaker": "payload"},
    seen={"encoder": "drive", "scale": "carriage", "probe": "payload"},
    angular=False,
    order=0,
)
"""SLIDER [kg, N/m, N s/m]: belt-driven slider with modes at 2.3, 12.9 and 17.2 Hz."""

SHAFT = _Chain(
    bodies=("rotor", "flywheel", "hub", "fan"),
    inertia=(0.012, 0.030, 0.016, 0.009),
    ground=((18.0, 0.010), (0.0, 0.006), (0.0, 0.006), (0.0, 0.012)),
    couplings=("shaft1", "shaft2", "shaft3"),
    coupling=((95.0, 0.010), (140.0, 0.010), (70.0, 0.008)),
    motors={"torque": "rotor", "brake": "hub"},
    seen={"gyro1": "rotor", "gyro2": "flywheel", "gyro3": "fan"},
    angular=True,
    order=1,
)
"""SHAFT [kg m^2, N m/rad, N m s/rad]: shaft with four discs and modes at 2.4, 12.0, 17.6 and 22.5 Hz."""


def _xml(chain: _Chain, timestep: float = 0.001, integrator: str = "RK4") -> str:
    """Return the MJCF of the nominal chain."""
    kind, unit = ("hinge", "0.05") if chain.angular else ("slide", "0.05")
    bodies, tendons = [], []
    for i, (name, inertia, (k, c)) in enumerate(zip(chain.bodies, chain.inertia, chain.ground, strict=True)):
        mass = inertia if not chain.angular else 1.0
        turn = inertia if chain.angular else 1e-3
        bodies.append(
            f'    <body name="{name}" pos="{0.3 * i:g} 0 0">\n'
            f'      <inertial pos="0 0 0" mass="{mass:g}" diaginertia="{turn:g} {turn:g} {turn:g}"/>\n'
            f'      <joint name="{name}" type="{kind}" axis="1 0 0" stiffness="{k:g}" damping="{c:g}"/>\n'
            f'      <geom type="box" size="{unit} {unit} {unit}" mass="0"/>\n    </body>'
        )
    for (a, b), name, (k, c) in zip(pairwise(chain.bodies), chain.couplings, chain.coupling, strict=True):
        tendons.append(
            f'    <fixed name="{name}" stiffness="{k:g}" damping="{c:g}" springlength="0">'
            f'<joint joint="{a}" coef="-1"/><joint joint="{b}" coef="1"/></fixed>'
        )
    motors = [f'    <motor name="{name}" joint="{body}"/>' for name, body in chain.motors.items()]
    sensor = "jointvel" if chain.order else "jointpos"
    seen = [f'    <{sensor} name="{name}" joint="{body}"/>' for name, body in chain.seen.items()]
    return "\n".join(
        [
            "<mujoco>",
            f'  <option timestep="{timestep:g}" integrator="{integrator}" gravity="0 0 0">'
            '<flag contact="disable"/></option>',
            "  <worldbody>",
            *bodies,
            "  </worldbody>",
            "  <tendon>",
            *tendons,
            "  </tendon>",
            "  <actuator>",
            *motors,
            "  </actuator>",
            "  <sensor>",
            *seen,
            "  </sensor>",
            "</mujoco>",
            "",
        ]
    )


def _benign(chain: _Chain, sd: Mapping[str, float]) -> tuple[Benign, ...]:
    out = [Benign(name=f"mass:{name}", kind="mass", sd=sd["mass"]) for name in chain.bodies]
    for names, springs in ((chain.bodies, chain.ground), (chain.couplings, chain.coupling)):
        for name, (k, c) in zip(names, springs, strict=True):
            out += [Benign(name=f"stiffness:{name}", kind="stiffness", sd=sd["stiffness"])] if k else []
            out += [Benign(name=f"damping:{name}", kind="damping", sd=sd["damping"])] if c else []
    out += [Benign(name=f"gain:{name}", kind="gain", sd=sd["gain"]) for name in chain.motors]
    out += [Benign(name=f"sensor:{name}", kind="sensor", sd=sd["sensor"]) for name in chain.seen]
    return tuple(out)


def _built(chain: _Chain, factors: Mapping[str, float]) -> Bench:
    """Return the chain with log-factors on its parameters."""

    def factor(name: str) -> float:
        return float(np.exp(factors.get(name, 0.0)))

    n = len(chain.bodies)
    M = np.diag([m * factor(f"mass:{name}") for name, m in zip(chain.bodies, chain.inertia, strict=True)])
    C, K = np.zeros((n, n)), np.zeros((n, n))
    order = [f"joint:{chain.bodies[0]}"]  # places in their order along the chain
    for i, name in enumerate(chain.couplings):
        order += [f"tendon:{name}", f"joint:{chain.bodies[i + 1]}"]
    places: dict[str, Place] = {}
    unit = np.eye(n)
    elements = [(f"joint:{name}", unit[i], *chain.ground[i]) for i, name in enumerate(chain.bodies)]
    elements += [
        (f"tendon:{name}", unit[i + 1] - unit[i], *chain.coupling[i]) for i, name in enumerate(chain.couplings)
    ]
    for place, row, k, c in elements:
        name = place.partition(":")[2]
        k, c = k * factor(f"stiffness:{name}"), c * factor(f"damping:{name}")
        K += k * np.outer(row, row)
        C += c * np.outer(row, row)
        at = order.index(place)
        pushed = next((m for m, body in chain.motors.items() if place == f"joint:{body}"), "")
        alike = (f"body:{name}",) if place.startswith("joint:") else ()
        near = tuple(order[max(at - 2, 0) : at] + order[at + 1 : at + 3])  # the next coupling and the next body
        places[place] = Place(row=row, angular=chain.angular, stiffness=k, alike=alike, near=near, actuator=pushed)
    kind = (("displacement", "m"), ("velocity", "m/s")), (("angle", "rad"), ("angular-velocity", "rad/s"))
    name, si = kind[chain.angular][chain.order]
    sensors = {
        s: Sensor(row=unit[chain.bodies.index(body)] * factor(f"sensor:{s}"), order=chain.order, kind=name, unit=si)
        for s, body in chain.seen.items()
    }
    actuators = {m: unit[chain.bodies.index(body)] * factor(f"gain:{m}") for m, body in chain.motors.items()}
    return Bench(M=M, C=C, K=K, places=places, actuators=actuators, sensors=sensors)


def _matrices(chain: _Chain, factors: Mapping[str, float]) -> tuple[Array, Array, Array]:
    bench = _built(chain, factors)
    return bench.M, bench.C, bench.K


def _blueprint(chain: _Chain, name: str, title: str, *, force: float, band_hz: tuple[float, float]) -> Blueprint:
    return Blueprint(
        name=name,
        title=title,
        build=lambda factors, shifts: _built(chain, factors),
        matrices=lambda factors: _matrices(chain, factors),
        benign=_benign(chain, SD),
        model={"mjcf": "rig.xml"},
        files={"rig.xml": _xml(chain)},
        uncertain={**SD, "inertia": SD["mass"]},
        rate_hz=500.0,
        substeps=20,
        seconds=12.0,
        band_hz=band_hz,
        force=force,
        input_kind="moment" if chain.angular else "force",
        input_unit="N m" if chain.angular else "N",
        exciters=tuple(chain.motors),
    )


def _varied(chain: _Chain, blueprint: Blueprint, rng: np.random.Generator) -> Blueprint:
    """Draw statement, step and integrator of the nominal model of one case."""
    sd, timestep = stated(STATED, rng), float(rng.choice(TIMESTEPS))
    integrator = str(rng.choice(list(INTEGRATORS), p=list(INTEGRATORS.values())))
    return replace(
        blueprint,
        benign=_benign(chain, sd),
        uncertain={**sd, "inertia": sd["mass"]},
        files={"rig.xml": _xml(chain, timestep, integrator)},
        coarse_step=0.0 if integrator == "RK4" else timestep,
    )


def _in_practice(chain: _Chain, blueprint: Blueprint) -> Blueprint:
    """Return a kind of bench whose cases vary as in practice."""
    return replace(blueprint, varied=partial(_varied, chain), wrong=WRONG, coloured=COLOURED, stray=STRAY)


def slider(*, is_varied: bool = False) -> Blueprint:
    """Return the belt-driven slider with measured displacements.

    Parameters
    ----------
    is_varied : bool
        Whether statement, noise and step of the nominal model vary from case to case.

    Returns
    -------
    Blueprint
        Kind of bench.
    """
    plain = _blueprint(SLIDER, "slider", "Belt-driven slider", force=6.0, band_hz=(0.8, 24.0))
    return _in_practice(SLIDER, plain) if is_varied else plain


def shaft(*, is_varied: bool = False) -> Blueprint:
    """Return the shaft with four discs and measured rates.

    Parameters
    ----------
    is_varied : bool
        Whether statement, noise and step of the nominal model vary from case to case.

    Returns
    -------
    Blueprint
        Kind of bench.
    """
    plain = _blueprint(SHAFT, "shaft", "Shaft with four discs", force=0.4, band_hz=(0.8, 30.0))
    return _in_practice(SHAFT, plain) if is_varied else plain
