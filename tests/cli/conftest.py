"""What the tests of the command line share: quick figures, for a page takes longer than the run that it shows.

Of a run one response is drawn, and nothing is moved apart; how figures look is tested in tests/views.
"""

import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine

from vlab.views.reports import run as run_report
from vlab.views.reports import run_files as run_view
from vlab.views.rerun import documents


@pytest.fixture(scope="module", autouse=True)
def quick_figures():
    with pytest.MonkeyPatch.context() as patch:
        for module in (documents, run_report, run_view):  # each has the name, so that none keeps the changed one
            patch.setattr(module, "PICTURES", 1)
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: {})
        yield
