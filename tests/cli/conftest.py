"""What the tests of the command line share: a run is drawn with one response, for a picture takes longer than the run."""

import pytest

from vlab.views import documents


@pytest.fixture(scope="session", autouse=True)
def one_picture():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(documents, "PICTURES", 1)
        yield
