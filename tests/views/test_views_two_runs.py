"""Two runs over each other: a plot for each channel of either, one scale for both structures."""

import numpy as np
import pytest
from command import run
from rerun import chunk
from rerun.chunk import RrdReader

from vlab.views.rerun.frames import Motion
from vlab.views.rerun.traces import axis_unit
from vlab.views.rerun.two_runs import WIDTHS, load_two, write_two_runs

QUICK = ["--plant", "modal", "--seconds", "0.5", "--period", "0.5", "--band", "4", "30"]  # one period: no responses


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    from vlab.cli import main

    top = tmp_path_factory.mktemp("two")
    assert main(["experiment", "beam", *QUICK, "--out", str(top / "open")]) == 0
    assert main(["experiment", "beam", *QUICK, "--law", "mfdrf", "--out", str(top / "closed")]) == 0
    return top / "open", top / "closed"


def texts(path):
    for piece in RrdReader(path).stream().to_chunks():
        if piece.entity_path == "/facts":
            table = piece.to_record_batch()
            return next(
                table.column(i).to_pylist()[0][0] for i, n in enumerate(table.schema.names) if n.endswith("text")
            )
    raise AssertionError


def blocks(path, component):
    out = {}
    for piece in chunk.RrdReader(path).stream().to_chunks():
        table = piece.to_record_batch()
        for i, name in enumerate(table.schema.names):
            if name.endswith(component) and not piece.is_static:
                out[piece.entity_path] = table.column(i).to_pylist()
    return out


def test_two_runs_are_shown_over_each_other(capsys, folders, tmp_path):
    status, out, _ = run(capsys, "show", *map(str, folders), "--save", str(tmp_path / "both.rrd"), "--json")
    assert status == 0
    assert "both.rrd" in out
    runs = load_two(folders)
    traces = blocks(tmp_path / "both.rrd", "Scalars:scalars")
    of_a, of_b = ({e for e in traces if e.startswith("/channels/") and e.endswith(f"/{letter}")} for letter in "ab")
    assert len(of_a) == len(runs[0].recording.channels) == 8  # no commands without a law
    assert len(of_b) == len(runs[1].recording.channels) == 11
    assert {e[:-2] for e in of_a} < {e[:-2] for e in of_b}
    found = {tuple(np.ravel(traces[entity])) for entity in of_b}
    factors = [axis_unit(channel.unit)[0] for channel in runs[1].recording.channels]
    assert found == {tuple(values) for values in (runs[1].recording.data * factors).T}
    assert WIDTHS[0] > WIDTHS[1]  # the second run is drawn over the first
    words = texts(tmp_path / "both.rrd")
    assert "law**: none / mfdrf" in words
    assert "seed" not in words  # the same in both


def test_both_structures_have_one_scale(folders, tmp_path):
    runs = load_two(folders)
    path = write_two_runs(tmp_path / "both.rrd", runs, exaggeration=100.0)
    points = blocks(path, "Points3D:positions")
    for letter, shown in zip("ab", runs, strict=True):
        drawn = np.array(points[f"/structures/{letter}/points/base"])[:, 0, 1]
        truth = shown.motion.deflections[:, shown.motion.names.index("base")]
        assert drawn == pytest.approx(100 * truth, rel=1e-5, abs=1e-9)  # drawn in single precision
    assert runs[0].motion.largest > runs[1].motion.largest  # the law does something


def test_one_run_twice_can_be_told_apart(folders):
    first, second = load_two([folders[0], folders[0]])
    assert first.name != second.name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["open", "nowhere"], "nowhere"),
        (["open", "open/recording.parquet"], "give folders written by vlab experiment"),
        (["open", "closed", "open"], "3 runs were given"),
        (["open", "--save", "x.rrd"], "--save is for two runs"),
        (["open", "closed", "--save", "x.html"], "name it x.rrd"),
        (["open", "closed", "--save", "missing/x.rrd"], "cannot be written"),
    ],
)
def test_what_cannot_be_shown_is_one_line(capsys, folders, monkeypatch, words, said):
    monkeypatch.chdir(folders[0].parent)
    before = sorted(folders[0].parent.rglob("*"))
    status, out, err = run(capsys, "show", *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert sorted(folders[0].parent.rglob("*")) == before


def test_a_run_without_its_motion_is_said(capsys, folders, tmp_path):
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in ("recording.parquet", "run.toml", "manifest.json"):
        (copy / name).write_bytes((folders[0] / name).read_bytes())
    (copy / "run.rrd").write_bytes((folders[0] / "run.rrd").read_bytes()[:1000])
    status, _, err = run(capsys, "show", str(copy), str(folders[1]), "--save", str(tmp_path / "x.rrd"))
    assert status == 2
    assert "no motion of a structure" in err
    assert isinstance(Motion.read(folders[0] / "run.rrd"), Motion)
