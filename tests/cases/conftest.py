"""The folder of a case in short form."""

import pytest
from form_rigs import RIG, columns, write_csv


@pytest.fixture
def folder(tmp_path):
    case = tmp_path / "case"
    case.mkdir()
    (case / "rig.xml").write_text(RIG)
    for k in (1, 2, 10):
        write_csv(case / f"run{k}.csv", columns(k))
    return case
