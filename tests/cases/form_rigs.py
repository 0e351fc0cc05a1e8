"""An arm of two joints with short recordings, for the short forms of a case."""

import numpy as np

RIG = """<mujoco><compiler angle="radian"/><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body name="arm"><joint name="shoulder_pan" axis="0 0 1" stiffness="4" damping="0.3" range="-2 2" limited="true"/>
  <geom size="0.05" mass="1" pos="0.2 0 0"/>
  <body name="fore" pos="0.4 0 0"><joint name="elbow_flex" axis="0 0 1" stiffness="2" damping="0.2"/>
    <geom size="0.05" mass="0.5" pos="0.2 0 0"/></body></body></worldbody>
<actuator><motor name="pan_motor" joint="shoulder_pan"/><position name="flex_servo" joint="elbow_flex" kp="5" kv="0.2"
  ctrllimited="true" ctrlrange="-2 2"/></actuator></mujoco>"""
SHARED = """
[[channel]]
column = "u"
at = "pan_motor"
kind = "moment"
unit = "N m"
input = true
hold = "zero"
[[channel]]
column = "q"
at = "joint:shoulder_pan"
kind = "angle"
unit = "rad"
"""
HEAD = '[model]\nmjcf = "rig.xml"\n'
N, DT = 200, 0.01
TIME = np.arange(N) * DT


def columns(seed=0):
    rng = np.random.default_rng(seed)
    return {"t": TIME, "u": np.repeat(rng.normal(size=N // 10), 10), "q": 0.1 * np.sin(3 * TIME + seed)}


def write_csv(path, table):
    rows = [",".join(table)]
    count = max(len(values) for values in table.values())
    for k in range(count):
        cells = [f"{v[k]:.17g}" if k < len(v) and np.isfinite(v[k]) else "" for v in table.values()]
        rows.append(",".join(cells))
    path.write_text("\n".join(rows) + "\n")


def write_case(folder, text):
    (folder / "case.toml").write_text(HEAD + text)
    return folder


def channel(column, at, kind, unit, *more):
    lines = [f'column = "{column}"', f'at = "{at}"', f'kind = "{kind}"', f'unit = "{unit}"', *more]
    return "\n".join(["[[recording.channel]]", *lines, ""])


Q = channel("q", "joint:shoulder_pan", "angle", "rad")
U = channel("u", "pan_motor", "moment", "N m", "input = true", 'hold = "zero"')
