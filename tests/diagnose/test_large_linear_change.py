"""A linear effect so large that the regression about the nominal model misses its size."""

from types import SimpleNamespace

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.cases.case import load_case
from vlab.diagnose.inference.hypothesis_fits import as_large_as_the_model
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.pipeline import diagnose
from vlab.physics.catalogue import EFFECTS

M, K, C = 1.0, 400.0, 0.4
CHAIN = f"""<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 0"><flag contact="disable"/></option><worldbody>
<body name="a"><joint name="j1" type="slide" axis="1 0 0" stiffness="{K}" damping="{C}"/><geom size="0.05" mass="{M}"/>
<body name="b"><joint name="j2" type="slide" axis="1 0 0" stiffness="{K}" damping="{C}"/><geom size="0.05" mass="{M}"/>
<body name="c"><joint name="j3" type="slide" axis="1 0 0" stiffness="{K}" damping="{C}"/><geom size="0.05" mass="{M}"/>
</body></body></body></worldbody>
<actuator><motor name="motor" joint="j1"/></actuator>
<sensor><jointpos name="first" joint="j1"/><jointpos name="third" joint="j3"/></sensor></mujoco>"""
RATE, SECONDS = 200.0, 10.0


def case_of(folder, damper):
    """Write runs of a chain whose second joint has a hidden damper, integrated by a method of order 8."""
    rng, t, records = np.random.default_rng(4), np.arange(round(RATE * SECONDS)) / RATE, []

    def slope(time, x, push):
        r, v = x[:3], x[3:]  # relative displacements and rates of the joints
        pull = K * r + C * v + np.array([0.0, damper * v[1], 0.0])
        absolute = (np.array([push(time), 0.0, 0.0]) - pull + np.array([pull[1], pull[2], 0.0])) / M
        return np.concatenate([v, np.diff(absolute, prepend=0.0)])

    for name, role in (("a", "fit"), ("b", "fit"), ("c", "holdout")):
        push = multisine(rng, 0.4, 8.0, SECONDS, 5.0)
        x = solve_ivp(
            slope, (0, SECONDS), np.zeros(6), "DOP853", t, rtol=1e-9, atol=1e-12, max_step=0.005, args=(push,)
        ).y
        noise = 0.003 * np.std(x, axis=1, keepdims=True) * rng.standard_normal(x.shape)
        columns = {"u": push(t), "first": (x + noise)[0], "third": (x + noise)[2]}
        records.append(Record(name=name, role=role, columns=columns, rate_hz=RATE))
    channels = [
        Channel(column="u", at="motor", kind="force", unit="N", is_input=True, hold="linear"),
        *(Channel(column=name, at=name, kind="displacement", unit="m") for name in ("first", "third")),
    ]
    write_case(folder, title="", mjcf=CHAIN, uncertain={}, channels=channels, records=records)
    return load_case(folder)


@pytest.mark.slow
@pytest.mark.parametrize("damper", [2.0, 20.0, 100.0])  # a damper of 20 is about critical, one of 100 locks the joint
def test_a_damper_of_any_size_is_found(tmp_path, damper):
    found = diagnose(case_of(tmp_path, damper)).diagnosis
    assert [(f.effect, f.place) for f in found.findings] == [("viscous-damping", "joint:j2")]
    assert found.findings[0].parameters["damping"]["value"] == pytest.approx(damper, rel=0.1)


@pytest.mark.parametrize(
    ("name", "key", "size"),
    [
        ("viscous-damping", "damping", 10.0 / 0.25),  # the first mode alone: damping times frequency is the stiffness
        ("added-mass", "mass", 1.0 / 0.25),  # twice the first modal mass
        ("stiffness-to-ground", "stiffness", 100.0 / 0.25),
        ("lost-stiffness", "share", 0.95),  # the largest share of the law
    ],
)
def test_a_linear_effect_is_tried_at_the_impedance_of_a_mode(name, key, size):
    place = Place(name="tip", kind="port", rows=np.array([[0.5, 0.1]]), stiffness=40.0)
    model = SimpleNamespace(reduced_model=SimpleNamespace(omega=np.array([10.0, 20.0])))
    small = Candidate(effect=EFFECTS[name], place=place, values={key: 1e-3}, log_likelihood_gain=1.0)
    (tried,) = as_large_as_the_model(model, small)
    assert tried.values == {key: pytest.approx(size)}
    assert not as_large_as_the_model(model, tried)  # no smaller size than the regression's
