"""Examples by name, the table of effects, nearest names, and a narrower search."""

import json
from typing import get_args

import pytest
from command import run

from vlab.api.diagnosis import candidate_effects, check_places
from vlab.cases import load_case
from vlab.cli.effects import REFERENCES
from vlab.diagnose.parameters.locations import Place, admissible, limited
from vlab.errors import BadExperiment, UnknownName, unknown_name
from vlab.files.examples import examples, located
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Reference


def test_examples_are_listed_opened_and_copied(capsys, tmp_path):
    status, out, _ = run(capsys, "examples", "--copy", str(tmp_path / "mine"), "--json")
    names = [entry["name"] for entry in json.loads(out)["examples"]]
    assert status == 0
    assert {"example:emps", "example:three_storey/modal", "example:hammer.csv"} <= set(names)
    assert load_case("example:emps").table.title == load_case(tmp_path / "mine" / "cases" / "emps").table.title
    assert run(capsys, "examples", "--copy", str(tmp_path / "mine"))[0] == 2
    assert all(example.path.exists() for example in examples())


def test_a_wrong_example_names_the_near_ones():
    with pytest.raises(UnknownName, match="did you mean 'emps'"):
        located("example:empsy")
    with pytest.raises(UnknownName, match="several cases; name one: example:three_storey/modal"):
        located("example:three_storey")
    assert located("emps") == "emps"


def test_effects_are_a_table_of_all_or_of_a_family(capsys):
    status, out, _ = run(capsys, "effects")
    assert status == 0
    assert len(out.splitlines()) == len(EFFECTS) + 4
    friction = run(capsys, "effects", "friction")[1]
    assert friction == run(capsys, "effects", "--family", "friction")[1]
    assert "stribeck-friction" in friction
    assert "dead-band" not in friction
    assert "largest reading" in run(capsys, "effects", "sensor-clipping")[1]
    status, _, err = run(capsys, "effects", "frict")
    assert status == 2
    assert "names that contain it: coulomb-friction" in err


@pytest.mark.parametrize(
    ("given", "known", "hint"),
    [
        ("35in", ["30in", "40in", "50in"], "did you mean '30in' or '40in'?"),
        ("38in", ["30in", "40in", "50in"], "did you mean '40in'?"),
        ("35in", ["coil:40in", "coil:20in"], "did you mean 'coil:40in'?"),
        ("mode3", ["mode1", "node3"], "did you mean 'mode1'?"),
        ("elbw", ["elbow", "wrist"], "did you mean 'elbow'?"),
    ],
)
def test_the_nearest_number_is_suggested(given, known, hint):
    assert hint in str(unknown_name("place", given, known))


def test_a_search_is_restricted_to_effects_and_places():
    assert [effect.name for effect in candidate_effects((), only=["dead-band", "coulomb-friction"])] == [
        "dead-band",
        "coulomb-friction",
    ]
    with pytest.raises(BadExperiment, match="give one of them"):
        candidate_effects((), ["friction"], ["dead-band"])
    with pytest.raises(UnknownName, match="did you mean 'dead-band'"):
        candidate_effects((), only=["deadband"])
    elbow = limited(EFFECTS["coulomb-friction"], ["elbow"])
    assert admissible(elbow, Place(name="joint:elbow", kind="port", rows=[[1.0]]))
    assert not admissible(elbow, Place(name="joint:wrist", kind="port", rows=[[1.0]]))
    assert admissible(EFFECTS["coulomb-friction"], Place(name="joint:wrist", kind="port", rows=[[1.0]]))
    plant = load_case("example:emps").plant
    check_places(plant, list(plant.ports)[:1])
    with pytest.raises(UnknownName, match="unknown place 'elbow'"):
        check_places(plant, ["elbow"])


def test_until_noise_needs_a_folder(capsys):
    status, _, err = run(capsys, "diagnose", "example:emps", "--until-noise")
    assert status == 2
    assert "give --out DIR as well" in err


def test_every_scale_of_a_parameter_has_words():
    assert set(REFERENCES) == set(get_args(Reference)) - {""}


def test_every_effect_prints_in_full(capsys):
    status, out, _ = run(capsys, "effects", "--full")
    assert status == 0
    assert all(f"\n{name}  [" in f"\n{out}" for name in EFFECTS)


def test_a_suggestion_is_not_buried_under_a_hundred_names():
    known = [f"effect-of-{k}" for k in ("friction", "stiffness", *map(str, range(100)))]
    assert str(unknown_name("effect", "effect-of-fricton", known)) == (
        "unknown effect 'effect-of-fricton'; did you mean 'effect-of-friction'? (102 names are accepted)"
    )
    assert str(unknown_name("effect", "wombat", known)).endswith("effect-of-99)")
