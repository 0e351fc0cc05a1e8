"""The hammer test that is shipped as an example: made with the beam in MuJoCo, and good for its modes."""

import json
from pathlib import Path

import numpy as np
import pytest
from command import run

from vlab.fe import FeModel
from vlab.files.assets import asset
from vlab.lab.run_folder import RunSettings, perform

EXAMPLE = asset("examples/hammer.csv")
HEAD = "# Hammer test of the beam, blows at the base; simulated by vlab, nothing was measured\nTime [s],Hammer,Vel40in,Vel20in,VelBase\n"
SETTINGS = RunSettings(
    structure="beam",
    excite="hammer",
    level=2.0,
    low_hz=0.5,
    high_hz=40.0,
    rate_hz=200.0,
    seconds=36.0,
    noise=1e-5,
    seed=1,
)
PLACES = ("40in", "20in", "base")


def as_csv(folder: Path) -> str:
    """Make the example: forces in N, velocities in mm/s, as a logger writes them."""
    recording = perform(SETTINGS.prepare(), folder).result.recording
    columns = [recording["force:base"], *(1e3 * recording[f"sensor:{place}"] for place in PLACES)]
    rows = zip(recording.time, *columns, strict=True)
    return HEAD + "".join(
        f"{t:.3f},{force:.4g}," + ",".join(f"{v:.2f}" for v in motion) + "\n" for t, force, *motion in rows
    )


def test_its_six_modes_are_those_of_the_beam(capsys, fe: FeModel):
    outputs = [word for name in ("Vel40in", "Vel20in", "VelBase") for word in ("--output", f"{name}=velocity,mm/s")]
    line = ["modal-test", str(EXAMPLE), "--input", "Hammer=force,N", *outputs, "--band", "1", "26", "--json"]
    status, out, _ = run(capsys, *line)
    found = [mode["hz"] for mode in json.loads(out)["modes"]]
    assert status == 0
    assert found == pytest.approx(fe.linear.freq[:6], rel=2.5e-3)


@pytest.mark.slow
def test_it_is_what_the_beam_does_under_the_hammer(tmp_path):
    made = as_csv(tmp_path)
    assert made.splitlines()[:2] == EXAMPLE.read_text(encoding="utf-8").splitlines()[:2]
    (tmp_path / "made.csv").write_text(made, encoding="utf-8")
    now, then = (np.loadtxt(path, delimiter=",", skiprows=2) for path in (tmp_path / "made.csv", EXAMPLE))
    assert now == pytest.approx(then, rel=2e-3, abs=0.02)  # another processor may round otherwise


def test_it_is_small():
    assert EXAMPLE.stat().st_size < 200_000
