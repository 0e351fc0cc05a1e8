"""The noise of recorded channels: white, low-passed by a logger, coarse; what a thing answers is no noise."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rigs import oscillator_case
from scipy import signal
from synthetic import run_of

from vlab.cases import load_case
from vlab.diagnose.data.noise import estimate_noise, noise_level
from vlab.diagnose.pipeline import diagnose

NOISE = 0.003
N = 12000
LOGGER = signal.firwin(201, 0.72)
"""A logger's filter: half the amplitude at .72 of half the rate, nothing is left at .78 - as 1/2.56 of the rate asks for."""


def resonator(u):
    """Answer of a resonance at a twentieth of half the rate."""
    pole = 0.997 * np.exp(0.05j * np.pi)
    return signal.lfilter([0.0, 0.003], [1.0, -2 * pole.real, abs(pole) ** 2], u)


def driven(seed, band=0.1):
    """An input of limited band and what it makes of the resonance."""
    rng = np.random.default_rng(seed)
    u = signal.sosfilt(signal.butter(12, band, output="sos"), rng.standard_normal(N))
    return u, resonator(u), rng.standard_normal(N) * NOISE


def logged(x):
    return np.convolve(np.pad(x, len(LOGGER) // 2, mode="edge"), LOGGER, mode="valid")


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("is_filtered", [False, True])
def test_noise_is_found_where_a_logger_left_it(seed, is_filtered):
    u, y, noise = driven(seed)
    record = logged(y + noise) if is_filtered else y + noise
    # 22 segments of half overlap and some hundred bins: medians scatter by 3 %, and are 3 % below the mean
    assert noise_level(record, u[:, None]) == pytest.approx(NOISE, rel=0.08)


def test_a_filter_takes_off_a_part_of_the_noise_itself():
    _, y, noise = driven(0)
    run = run_of(np.arange(N) / 1000.0, {"y": logged(y + noise)})
    # of white noise .72 of the power is left
    assert estimate_noise(run, "y").rms == pytest.approx(np.sqrt(0.72) * NOISE, rel=0.08)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_the_input_explains_is_no_noise(seed):
    """An accelerometer on a mass shows a flat answer above its resonance, up to where the excitation ends."""
    u, y, noise = driven(seed, band=0.5)
    record = y - 0.03 * u + noise
    assert noise_level(record, u[:, None]) == pytest.approx(NOISE, rel=0.08)
    assert noise_level(record) > 3 * NOISE  # without the input nobody can tell


def test_blows_are_no_noise():
    """An accelerometer where a hammer hits shows the blow itself, which has all frequencies; between blows there is silence."""
    rng = np.random.default_rng(5)
    blows = np.zeros(N)
    for at in (500, 4500, 9000):
        blows[at : at + 3] = [0.5, 1.0, 0.5]
    record = resonator(blows) + 2.0 * blows + NOISE * rng.standard_normal(N)
    assert noise_level(record, blows[:, None]) == pytest.approx(NOISE, rel=0.08)


def test_an_answer_that_fades_away_is_no_noise():
    rng = np.random.default_rng(3)
    blow = np.zeros(N)
    blow[100::4000] = 1.0
    record = resonator(resonator(blow)) * 1e3
    assert noise_level(record + 1e-5 * rng.standard_normal(N)) == pytest.approx(max(1e-5, 1e-4 * record.std()), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "verdict"), [("none", "nothing-missing"), ("coulomb-friction", "missing-physics")])
def test_recordings_of_a_logger_are_diagnosed_as_any(tmp_path, effect, verdict):
    rig = oscillator_case(tmp_path, effect=effect)
    for path in sorted(tmp_path.glob("*.parquet")):
        table = pq.read_table(path)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        pq.write_table(pa.table({n: logged(c) if n.startswith("y") else c for n, c in columns.items()}), path)
    found = diagnose(load_case(tmp_path)).diagnosis
    assert found.verdict == verdict
    assert [f.effect for f in found.findings] == ([] if effect == "none" else [rig.effect])
