"""Packed campaigns: nothing is lost, and nothing can be changed unnoticed."""

import json
import lzma
import shutil

import numpy as np
import pytest
from command import run
from mutated import mutated_text
from sealed_cases import edit

from vlab.errors import BadProof, VlabError
from vlab.files.assets import asset
from vlab.proof.pack import gather, packed, read_pack, unpack, write_pack
from vlab.proof.prove import prove, prove_packed, read_commitments
from vlab.proof.seal import SCORE, answers_folder, checked_commitments, read_json, truth_folder, write_json

SHIPPED = sorted(asset("evidence").glob("*.jsonl.xz"))
MUTATIONS, MUTATED = 24, 150


def lines_of(file):
    """Return the documents of a packed campaign."""
    return [json.loads(line) for line in lzma.decompress(file.read_bytes()).splitlines()]


def rewrite(file, lines):
    """Write documents as someone would who changes a packed campaign."""
    file.write_bytes(lzma.compress(b"".join(json.dumps(line).encode() + b"\n" for line in lines)))


@pytest.fixture
def folders(cases, answered):
    """The folders of a finished campaign."""
    prove(cases, answers_folder(cases), jobs=1)
    return cases, answers_folder(cases), truth_folder(cases)


@pytest.fixture
def file(folders, tmp_path):
    write_pack(gather(*folders), tmp_path / "small.jsonl.xz")
    return tmp_path / "small.jsonl.xz"


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_evidence_is_a_file_a_campaign():
    """Beside the campaigns stand their description and commitments to cases that are not answered yet."""
    assert [file.name for file in SHIPPED] == [
        "arms-14.jsonl.xz",
        "arms-16.jsonl.xz",
        "arms-16b.jsonl.xz",
        "arms-20.jsonl.xz",
        "beams-4.jsonl.xz",
        "beams-4b.jsonl.xz",
        "campaign-340.jsonl.xz",
        "fresh-79.jsonl.xz",
        "later-81.jsonl.xz",
        "pendulums-16.jsonl.xz",
        "pendulums-16b.jsonl.xz",
        "rigs-24.jsonl.xz",
        "rigs-30.jsonl.xz",
    ]
    assert {path.name for path in asset("evidence").iterdir() if path.is_dir()} <= {"sealed"}
    cases = sum(len(read_pack(file).answers) for file in SHIPPED)
    assert sum(file.stat().st_size for file in SHIPPED) < 2000 * cases  # 1 MB for the first 500
    for path in asset("evidence").glob("sealed/*"):
        document = checked_commitments(read_json(path), where=str(path))
        answered = asset("evidence") / f"{path.stem}.jsonl.xz"
        assert not answered.exists() or read_pack(answered).commitments == document


def test_a_campaign_comes_out_of_its_file_with_the_bytes_of_its_folders(folders, file, tmp_path):
    (tmp_path / "out").mkdir()
    there = unpack(read_pack(file), tmp_path / "out")
    for before, after in zip(folders, (there, answers_folder(there), truth_folder(there)), strict=True):
        kept = {name: content for name, content in contents(before).items() if before != folders[0]}
        kept = kept or {name: content for name, content in contents(before).items() if name.name == "commitments.json"}
        kept = {name: content for name, content in kept.items() if name.name != ".lock"}
        assert contents(after) == kept
    assert packed(gather(there, answers_folder(there), truth_folder(there))) == file.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda file: file.name)
def test_a_shipped_campaign_comes_out_of_its_folders_with_the_same_content(shipped, tmp_path):
    there = unpack(read_pack(shipped), tmp_path)
    again = packed(gather(there, answers_folder(there), truth_folder(there)))
    assert lzma.decompress(again) == lzma.decompress(shipped.read_bytes())  # another liblzma may pack otherwise


def test_a_file_counts_to_the_score_and_the_page_of_the_folders(folders, file, tmp_path, capsys):
    out = tmp_path / "out"
    status, text, _ = run(capsys, "prove", str(file), "--jobs", "1", "--out", str(out))
    assert status == 0
    assert "every measure is that of the packed score" in text
    assert run(capsys, "prove", str(folders[0]), "--jobs", "1")[0] == 0
    targets = {m["measure"]: m["target"] for m in json.loads((folders[1] / SCORE).read_text())["measures"]}
    assert targets["out of library: physics named"] == "<= 0.05"  # as the manifest sets down
    for name in (SCORE, "report.html"):
        assert (out / "cases-answers" / name).read_bytes() == (folders[1] / name).read_bytes()
    assert len(run(capsys, "prove", str(out / "cases"), "--jobs", "1")[1]) > 0  # an unpacked campaign goes on


def test_a_file_is_unpacked_into_the_next_numbered_folder(file, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number in ("001", "002"):
        assert run(capsys, "prove", str(file), "--jobs", "1")[0] == 0
        assert (tmp_path / "out" / f"small-{number}" / "cases-answers" / SCORE).exists()


def test_one_changed_byte_of_a_file_is_refused_in_one_line(file, tmp_path, capsys):
    sound = file.read_bytes()
    drawn = np.random.default_rng(1).integers(0, len(sound), MUTATIONS)
    for place in (0, len(sound) - 1, *drawn):
        file.write_bytes(sound[:place] + bytes([sound[place] ^ 1]) + sound[place + 1 :])
        status, out, err = run(capsys, "prove", str(file), "--jobs", "1", "--out", str(tmp_path / "out"))
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert f"{file}: damaged, or not a packed campaign" in err
        assert not (tmp_path / "out").exists()
    for content in (sound[:-1], sound + sound, b"text", lzma.compress(b""), lzma.compress(b"{}\n")):
        file.write_bytes(content)
        with pytest.raises(BadProof, match="not a packed campaign"):
            read_pack(file)


def test_a_file_that_unpacks_to_too_much_is_refused(file, monkeypatch):
    size = len(lzma.decompress(file.read_bytes()))
    monkeypatch.setattr("vlab.proof.pack.unpacked_limit", lambda n_bytes: size - 1)
    with pytest.raises(BadProof, match=f"more than {size - 1} bytes when unpacked"):
        read_pack(file)
    monkeypatch.setattr("vlab.proof.pack.unpacked_limit", lambda n_bytes: size)
    assert read_pack(file).answers


CHANGES = {
    "answer": (lambda head, row: row["answer"].update(verdict="none-of-these"), "changed after it was frozen"),
    "truth": (lambda head, row: row["truth"]["truth"].update(noise="none"), "the truth does not match its commitment"),
    "salt": (lambda head, row: row["truth"].update(salt="0" * 32), "the truth does not match its commitment"),
    "commitment": (lambda head, row: row["commitment"].update(truth="0" * 64), "given to other cases"),
    "hash": (lambda head, row: row.update(frozen="0" * 64), "changed after it was frozen"),
    "manifest": (lambda head, row: head["manifest"].update(code="0"), "the manifest was changed"),
    "seed": (lambda head, row: head["plan"]["truth"].update(seed=4), "the truth does not match its commitment"),
    "name": (lambda head, row: row.update(case="../case-001"), "is no commitment to a case"),
    "answer left out": (lambda head, row: [row.pop(key) for key in ("answer", "truth", "frozen")], "were left out"),
    "part left out": (lambda head, row: row.pop("truth"), "line 2 is no case of a packed campaign"),
    "twice": (lambda head, row: row.update(case="case-002"), "a case is there twice"),
    "targets": (
        lambda head, row: head["manifest"]["targets"].update({"Brier score": {"at_most": "0"}}),
        "the manifest was changed",
    ),
    "format": (lambda head, row: head.update(format="vlab-campaign-0"), "not a packed campaign"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_change_of_the_content_is_refused_in_one_line(what, file, tmp_path, capsys):
    head, row, *more = lines_of(file)
    change, said = CHANGES[what]
    change(head, row)
    rewrite(file, [head, row, *more])
    status, out, err = run(capsys, "prove", str(file), "--jobs", "1", "--out", str(tmp_path / "out"))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert str(file) in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_mutated_content_is_counted_or_refused(file, tmp_path):
    """Of what no hash covers, the score, the openings and the versions of the generator, any change is possible."""
    sound, counted, said = lzma.decompress(file.read_bytes()).splitlines(), 0, []
    for number in range(MUTATED):
        rng = np.random.default_rng(number)
        lines = list(sound)
        which = rng.integers(len(lines))
        lines[which] = mutated_text(lines[which], rng)
        file.write_bytes(lzma.compress(b"\n".join(lines)))
        try:
            prove_packed(file, tmp_path / f"out-{number}", jobs=1)
            counted += 1
        except VlabError as error:
            said.append(str(error))
    assert not [message for message in said if "\n" in message]
    assert counted < MUTATED / 2


def test_a_changed_score_is_told(file, tmp_path, capsys):
    head, *rows = lines_of(file)
    alarms = next(m for m in head["score"]["measures"] if m["measure"].startswith("null: anything"))
    alarms["count"] += 1
    rewrite(file, [head, *rows])
    status, text, _ = run(capsys, "prove", str(file), "--jobs", "1", "--out", str(tmp_path / "out"))
    assert status == 1
    assert f"1 measures differ from the packed score: {alarms['measure']}" in text


def test_a_truth_without_its_salt_is_made_again_out_of_a_file(file, folders, tmp_path, monkeypatch):
    path = folders[2] / "case-002.json"
    recordings = read_commitments(folders[0])["cases"]["case-002"]["recordings"]
    edit(path, lambda document: document.update(recordings=recordings, salt=None))
    write_json(path, {key: value for key, value in json.loads(path.read_text()).items() if key != "salt"})
    lost = tmp_path / "lost.jsonl.xz"
    write_pack(gather(*folders), lost)
    asked = []
    monkeypatch.setattr("vlab.proof.prove.check_remade", lambda truths, commitments, names, *how: asked.append(names))
    found, changed = prove_packed(lost, tmp_path / "out")
    assert (asked, found["truths_made_again"], changed) == ([["case-002"]], ["case-002"], [])


def test_a_finished_campaign_is_packed_at_the_end_and_no_file_is_written_over(cases, answered, tmp_path, capsys):
    file = tmp_path / "new.jsonl.xz"
    (truth_folder(cases) / "case-002.json").rename(tmp_path / "kept.json")  # sealed, and not asked for
    words = ["prove", str(cases), "--jobs", "1", "--pack", str(file)]
    assert run(capsys, *words, "--first", "1")[0] == 0
    campaign = read_pack(file)
    assert list(campaign.commitments["cases"]) == ["case-001", "case-002"]
    assert list(campaign.truths) == list(campaign.answers) == ["case-001"]
    assert campaign == gather(cases, answers_folder(cases), truth_folder(cases))
    before = file.read_bytes()
    status, out, err = run(capsys, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "is there already and is never written over" in err
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "words", [["--truth", "x"], ["--first", "1"], ["--baselines", "0"], ["--reports", "1"], ["--pack", "y"]]
)
def test_options_of_folders_are_refused_for_a_file(words, file, capsys, tmp_path):
    status, out, err = run(capsys, "prove", str(file), *words, "--out", str(tmp_path / "out"))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"{words[0]} belongs to a folder of cases" in err
    assert run(capsys, "prove", str(tmp_path / "none.jsonl.xz"))[2].count("no such file") == 1


@pytest.mark.slow
def test_recordings_are_made_again_out_of_a_file(cases, file, tmp_path, capsys):
    words = ["--only", "case-002", "--with-truth", "--jobs", "1"]
    assert run(capsys, "conceal", "--again", str(file), *words, "--out", str(tmp_path / "again"))[0] == 0
    assert run(capsys, "conceal", "--again", str(cases), *words, "--out", str(tmp_path / "known"))[0] == 0
    for suffix in ("", "-truth"):
        here, there = (contents(tmp_path / f"{name}{suffix}") for name in ("again", "known"))
        assert here == there
    shutil.rmtree(tmp_path / "again")
    status, _, err = run(capsys, "conceal", "--again", str(file), "--only", "case-9", "--out", str(tmp_path / "again"))
    assert (status, (tmp_path / "again").exists()) == (2, False)
    assert f"{file} has no case 'case-9'" in err
    head, *rows = lines_of(file)
    head["plan"]["truth"]["seed"] = 4
    rewrite(file, [head, *rows])
    status, _, err = run(capsys, "conceal", "--again", str(file), "--out", str(tmp_path / "again"))
    assert (status, (tmp_path / "again").exists()) == (2, False)
    assert f"{file}: plan: the truth does not match its commitment" in err
