"""``vlab modal-test`` on recordings from elsewhere, on dwells, and beside the plant."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from command import run as run_summary
from scipy import linalg, signal

from vlab.lab.plant_modes import plant_modes
from vlab.lab.run_folder import RunSettings, perform
from vlab.views.reports import modal_test as modal_test_report

FREQ, ZETA = np.array([6.0, 17.0]), np.array([0.01, 0.008])
SHAPES = np.array([[1.0, 1.0], [0.6, -0.9]])
G = 9.80665


def accelerations(force, t):
    """Two modes, the force at the first point: accelerations at both [m/s^2]."""
    out = np.zeros((t.size, 2))
    for k, omega in enumerate(2 * np.pi * FREQ):
        system = signal.lti([1.0, 0.0, 0.0], [1.0, 2 * ZETA[k] * omega, omega**2])
        out += np.outer(signal.lsim(system, SHAPES[0, k] * force, t)[1], SHAPES[:, k])
    return out


def write_csv(path, t, force, motion, header="Time [s],Hammer,Acc1,Acc2"):
    rows = np.column_stack([t, force, motion / G])
    path.write_text(header + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows) + "\n")
    return path


@pytest.fixture(scope="module")
def hammer_csv(tmp_path_factory):
    t = np.arange(12000) / 400.0
    force = np.zeros_like(t)
    for begin in (0.5, 10.5, 20.5):
        inside = (t >= begin) & (t < begin + 0.02)
        force[inside] += np.sin(np.pi * (t[inside] - begin) / 0.02)
    return write_csv(tmp_path_factory.mktemp("hammer") / "hammer.csv", t, force, accelerations(force, t))


@pytest.fixture(scope="module", autouse=True)
def quick(quick_layout):
    """Figures of pages are not looked at here."""


def run(capsys, *words):
    return run_summary(capsys, *(str(word) for word in words))


LABELS = ("--input", "Hammer=force,N", "--output", "Acc1=acceleration,g", "--output", "Acc2=acceleration,g")


@pytest.mark.slow
def test_a_hammer_test_from_elsewhere(capsys, hammer_csv, tmp_path):
    out = tmp_path / "test"
    status, text, _ = run(capsys, "modal-test", hammer_csv, *LABELS, "--band", 3, 25, "--json", "--out", out)
    document = json.loads(text)
    assert status == 0
    assert document["signals"] == [{"kind": "impact", "recognised": True}]
    modes = document["modes"]
    assert [m["hz"] for m in modes] == pytest.approx(FREQ, rel=1e-3)
    # the window adds -ln(.05) / 10 s = 0.3 1/s, a damping ratio of .008 at 6 Hz: uncorrected, the first would be .018
    assert [m["zeta"] for m in modes] == pytest.approx(ZETA, rel=0.02)
    assert modes[1]["shape"]["Acc2"] / modes[1]["shape"]["Acc1"] == pytest.approx(-0.9, rel=0.02)
    assert modes[0]["peak_shape"]["Acc2"] == pytest.approx(0.6, rel=0.05)
    page = (out / "report.html").read_text()
    for part in ("Stabilisation", "Mode shapes", "exponential window", "peak level"):
        assert part in page
    assert not re.search(r"(src|href)=\"https?:", page)  # one file, readable offline
    assert {p.name for p in out.iterdir()} >= {
        "stabilisation.svg",
        "mac.svg",
        "shapes.svg",
        "frf-Acc1.svg",
        "manifest.json",
    }


@pytest.mark.slow
def test_a_stepped_sine_from_elsewhere(capsys, tmp_path):
    freq = np.concatenate([np.linspace(4, 5.7, 8), np.linspace(5.8, 6.2, 11), np.linspace(6.3, 8, 8)])
    t = np.arange(round(len(freq) * 20 * 100)) / 100.0
    step = np.minimum((t / 20).astype(int), len(freq) - 1)
    begun = np.concatenate([[0.0], np.cumsum(freq[:-1] * 20)])
    force = np.sin(2 * np.pi * (begun[step] + freq[step] * (t - 20 * step)))
    path = write_csv(tmp_path / "steps.csv", t, force, accelerations(force, t))
    # half a step leaves exp(-zeta omega 10 s) = 2 % of what the last one left: well below 0.1 % of the frequency
    for given in ((), ("--dwell", 20)):
        status, text, _ = run(capsys, "modal-test", path, *LABELS, "--modes", 1, "--json", *given)
        document = json.loads(text)
        assert status == 0
        assert document["signals"] == [{"kind": "stepped", "recognised": not given}]
        assert document["modes"][0]["hz"] == pytest.approx(FREQ[0], rel=1e-3)
        assert document["modes"][0]["zeta"] == pytest.approx(ZETA[0], rel=0.05)


@pytest.mark.slow
def test_stamps_of_six_decimals_are_a_rate(capsys, tmp_path):
    t = np.arange(12288) / 409.6
    force = np.where((t >= 0.5) & (t < 0.52), np.sin(np.pi * (t - 0.5) / 0.02), 0.0)
    few = write_csv(tmp_path / "few.csv", np.round(t, 6), force, accelerations(force, t))
    status, text, _ = run(capsys, "modal-test", few, *LABELS, "--band", 3, 25, "--json")
    assert status == 0
    assert [m["hz"] for m in json.loads(text)["modes"]] == pytest.approx(FREQ, rel=1e-3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "name them with --input and --output"),
        (("--input", "Hammer", "--output", "Acc9"), "Acc9"),
        (("--input", "Hammer=force,furlong", "--output", "Acc1"), "furlong"),
        (("--input", "Hammer=", "--output", "Acc1"), "has not the form"),
        ((*LABELS, "--time", "Clock"), "Clock"),
        ((*LABELS, "--rate", "400", "--time", "Time [s]"), "both"),
        ((*LABELS, "--against-plant"), "needs run folders"),
        ((*LABELS, "--signal", "periodic"), "needs its period"),
        ((*LABELS, "--window-end", "2"), "accepted: above 0 up to 1"),
        ((*LABELS, "--signal", "random", "--window-end", "2"), "accepted: above 0 up to 1"),
        ((*LABELS, "--modes", "0"), "0 modes cannot be reported"),
        ((*LABELS, "--segment", "-1"), "segment_s is -1 s"),
        ((*LABELS, "--signal", "random", "--segment", "1e12"), "0 segments of 1e+12 s"),
        ((*LABELS, "--signal", "stepped", "--dwell", "1e-4"), "no steps of a sine"),
    ],
)
def test_bad_input_is_one_line(capsys, hammer_csv, tmp_path, words, message):
    out = tmp_path / "never"
    status, text, err = run(capsys, "modal-test", hammer_csv, *words, "--out", out)
    assert status == 2
    assert text == ""
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.slow
def test_a_dwell_on_the_bench_is_read(capsys, tmp_path):
    status, _, err = run(
        capsys, "experiment", "beam", "--plant", "modal", "--excite", "dwell:hz=4.804,forces=1/0.5,drive_s=40", "--at", "base,20in",
        "--level", 0.01, "--seconds", 60, "--rate", 500, "--out", tmp_path / "run",
    )  # fmt: skip
    assert status == 0, err
    status, text, _ = run(capsys, "modal-test", tmp_path / "run", "--json", "--out", tmp_path / "test")
    document = json.loads(text)
    (mode,) = document["modes"]
    assert status == 0
    assert mode["zeta"] == pytest.approx(0.002, rel=0.05)  # of the published structure, from the decay
    assert mode["hz"] == pytest.approx(4.8043, rel=1e-3)
    assert set(mode["forces"]) == {"excitation:base", "excitation:20in"}
    assert "Modes held by dwells" in (tmp_path / "test" / "report.html").read_text()


SENSORS = ("--output", "sensor:base", "--output", "sensor:40in")


@pytest.mark.slow
def test_the_plant_beside_the_test(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(modal_test_report, "DRAWN", 1)  # a figure takes longer than the fit
    monkeypatch.setattr(modal_test_report, "DISTORTED", 1)
    for place in ("base", "20in"):
        settings = RunSettings(
            structure="beam", plant="modal", at=place, level=0.05, low_hz=8.0, high_hz=17.0, period_s=10.0, seconds=40.0, rate_hz=500.0, noise=1e-4
        )  # fmt: skip
        (tmp_path / place).mkdir()
        perform(settings.prepare(), tmp_path / place).finish(tmp_path / place)
    runs = [tmp_path / place for place in ("base", "20in")]
    status, text, _ = run(
        capsys, "modal-test", *runs, *SENSORS, "--band", 8, 17, "--against-plant", "--json", "--out", tmp_path / "t"
    )
    document = json.loads(text)
    assert [m["ok"] for m in document["against_plant"]] == [True, True, True]
    assert status == 0
    assert set(document["modes"][0]["dwell"]["forces"]) == {"excitation:base", "excitation:20in"}
    assert "Force appropriation" in (tmp_path / "t" / "report.html").read_text()
    status, text, _ = run(capsys, "modal-test", runs[0], *SENSORS, "--band", 8, 17, "--modes", 2, "--against-plant")
    assert status == 1  # one of the three is missing
    assert "2 of 3 modes of the plant found" in text


def test_the_modes_of_the_plant_are_those_of_its_steps():
    # a semi-implicit step raises 50 Hz by (omega dt)^2 / 24 = 0.1 % at 2 kHz, more than the noise of any estimate
    plant = RunSettings(structure="beam").prepare().plant
    modes = plant_modes(plant, ["sensor:base", "sensor:20in", "sensor:40in"], low_hz=1.0, high_hz=60.0)
    linear = plant.linearise()
    exact = np.sqrt(np.sort(linalg.eigh(linear.K, linear.M, eigvals_only=True))) / (2 * np.pi)
    last = exact[np.argmin(np.abs(exact - modes.freq[-1]))]
    omega, h = 2 * np.pi * last, plant.timestep
    grown = (omega * h) ** 2 / 24 + modes.zeta[-1] * omega * h / 2
    assert modes.freq[-1] / last - 1 == pytest.approx(grown, rel=0.02)


@pytest.mark.slow
def test_a_modal_test_on_the_defaults_holds_against_the_plant(capsys, tmp_path):
    assert run(capsys, "experiment", "beam", "--out", tmp_path / "run")[0] == 0
    status, text, err = run(capsys, "modal-test", tmp_path / "run", "--against-plant")
    assert (status, err) == (0, "")
    assert "8 of 8 modes of the plant found" in text


@pytest.mark.parametrize(
    ("band", "words"),
    [((0.1, 2.0), "beside 2 identified modes: noise"), ((3.0, 4.0), "where no mode was identified; if that is noise")],
)
def test_a_band_with_modes_is_not_to_be_excluded(band, words):
    poles = SimpleNamespace(residual=0.5, freq=np.array([0.7, 1.9, 8.0]), confidence=np.ones(3), freq_sd=np.zeros(3))
    result = SimpleNamespace(
        notes=(), poles=poles, misfit_band=lambda: band, signals=(), skipped_s=(), still_ringing=lambda: np.zeros(3)
    )
    (line,) = [text for text in modal_test_report.doubts(result) if "90 %" in text]
    assert words in line
    assert ("--band" in line) == ("no mode" in line)


def test_a_written_folder_is_named(capsys, hammer_csv, tmp_path, monkeypatch):
    monkeypatch.setattr(modal_test_report, "DRAWN", 1)
    status, text, err = run(capsys, "modal-test", hammer_csv, *LABELS, "--out", tmp_path / "out")
    assert (status, err) == (0, "")
    assert f"written to {tmp_path / 'out'}: report.html" in text
