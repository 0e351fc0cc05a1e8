"""Effects written on the command line and in cases."""

import json

import numpy as np
import pytest
from physics_rig import chain_rig

from vlab.cases.compare import compare_case
from vlab.cli import main
from vlab.errors import BadCase, BadExperiment, BadUnit, UnknownName
from vlab.physics.attach import Attached, effect_tables
from vlab.physics.catalogue import EFFECTS
from vlab.physics.spec import parse_effect


def test_an_effect_is_read_with_its_units():
    one = parse_effect("coulomb-friction@joint:hinge:force=0.05lbf")
    assert (one.effect.name, one.place) == ("coulomb-friction", "joint:hinge")
    assert one.values["force"] == pytest.approx(0.05 * 4.4482216152605)
    two = parse_effect("jenkins-slip@20in:force=2e-3 ,slip=0.1 mm")
    assert two.values == pytest.approx({"force": 2e-3, "slip": 1e-4})
    assert parse_effect("force-offset@20in:force=-2e-3").values["force"] == -2e-3
    with pytest.raises(BadExperiment, match="force = -0.002; it must be positive"):
        parse_effect("jenkins-slip@20in:force=-2e-3,slip=0.1 mm")
    assert parse_effect("crosstalk@sensor:20in/coil:base:share=1e-3").place == "sensor:20in/coil:base"
    assert parse_effect("coulomb-friction@joint:hinge:force=2 lbf in").values["force"] == pytest.approx(
        0.22597, rel=1e-4
    )


@pytest.mark.parametrize(
    ("text", "kind", "says"),
    [
        ("coulomb-friction", BadExperiment, "form"),
        ("coulomb-friction@20in", BadExperiment, "form"),
        ("coulomb-friction@20in:force=", BadExperiment, "param=value"),
        ("coulomb-friction@20in:force=two", BadExperiment, "param=value"),
        ("coulomb-friction@20in:forec=2", UnknownName, "did you mean 'force'"),
        ("coulomb@20in:force=2", UnknownName, "did you mean"),
        ("coulomb-friction@20in:force=2kg", BadUnit, "kg"),
        ("jenkins-slip@20in:force=2", BadExperiment, "lacks slip"),
    ],
)
def test_mistakes_are_one_line(text, kind, says):
    with pytest.raises(kind, match=says):
        parse_effect(text)


def test_the_catalogue_on_the_command_line(capsys):
    assert main(["effects", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [e["name"] for e in listed] == list(EFFECTS)
    assert all({"name", "family", "law", "places", "parameters", "words"} <= set(e) for e in listed)
    assert main(["effects", "hardening"]) == 0
    assert "F = -k3 z^3" in capsys.readouterr().out
    assert main(["effects", "nothing"]) == 2


def test_an_experiment_with_effects(tmp_path, capsys):
    common = ["experiment", "beam", "--plant", "modal", "--seconds", "1", "--law", "mfdrf", "--json"]
    assert main([*common, "--out", str(tmp_path / "plain")]) == 0
    effects = ["--effect", "added-mass@40in:mass=0.1lb", "--effect", "sensor-gain@sensor:base:gain=0.5"]
    assert main([*common, *effects, "--out", str(tmp_path / "more")]) == 0
    from vlab.lab.run_folder import load_run

    plain, more = load_run(tmp_path / "plain")[0], load_run(tmp_path / "more")
    assert more[1].effect == ("added-mass@40in:mass=0.1lb", "sensor-gain@sensor:base:gain=0.5")
    assert np.std(more[0]["sensor:40in"] - plain["sensor:40in"]) > 0.01 * np.std(plain["sensor:40in"])
    capsys.readouterr()
    assert main([*common, "--effect", "added-mass@45in:mass=1", "--out", str(tmp_path / "no")]) == 2
    assert capsys.readouterr().err.startswith("error: unknown place '45in'")
    assert not (tmp_path / "no").exists()


def test_a_case_with_effects(tmp_path):
    rig = chain_rig()
    table = effect_tables([Attached(EFFECTS["bouc-wen"], "joint:a", {"force": 2.0, "yield": 0.004})])
    for file in rig.case.folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    case = tmp_path / "case.toml"
    text = case.read_text()
    case.write_text(text.replace("[[recording]]", table + "\n[[recording]]", 1))
    run = compare_case(tmp_path).runs[0]
    simulated = run.simulated.select(list(rig.problem.names)).data
    expected = rig.in_mujoco([("bouc-wen", "joint:a", {"force": 2.0, "yield": 0.004})])
    assert np.array_equal(simulated, expected)
    case.write_text(text.replace("[[recording]]", table.replace("joint:a", "joint:d") + "\n[[recording]]", 1))
    with pytest.raises(BadCase, match=r"model.effect\[0\].*joint:a"):
        compare_case(tmp_path)
    case.write_text(text.replace("[[recording]]", table.replace("bouc-wen", "own.py:X") + "\n[[recording]]", 1))
    with pytest.raises(BadCase, match="unknown effect"):
        compare_case(tmp_path)
