"""The shell completes commands, options and names."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def completed(line: str, folder: Path) -> list[str]:
    """Return what the shell would offer after a line."""
    answer = folder / "answer"
    answer.touch()
    words = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n"}
    environment = {**os.environ, **words, "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-m", "vlab"], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    return [word.strip() for word in answer.read_text().split("\n") if word.strip()]


@pytest.mark.slow
def test_commands_options_and_names_are_completed(tmp_path):
    pytest.importorskip("argcomplete", reason="argcomplete is not installed (pip install 'vlab-vibration[test]')")
    assert completed("vlab diag", tmp_path) == ["diagnose"]
    assert completed("vlab diagnose --unt", tmp_path) == ["--until-noise"]
    assert completed("vlab diagnose --family fri", tmp_path) == ["friction"]
    assert completed("vlab effects coul", tmp_path) == ["coulomb-friction"]
    (tmp_path / "emma.toml").touch()
    assert "emma.toml" in completed("vlab check em", tmp_path)
