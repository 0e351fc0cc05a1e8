"""Parts that many tests share, built once."""

import os
import signal
import time
from collections.abc import Iterator

from vlab.cli import ONE_THREAD

os.environ.update(dict.fromkeys(ONE_THREAD, "1"))  # as the command line does, before numpy is loaded

import matplotlib as mpl
import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine

from vlab.fe import FeModel, build_fe_model
from vlab.hardware import Hardware, load_hardware
from vlab.plants import Plant, build_plant
from vlab.structure import load_structure
from vlab.structure.model import Structure

mpl.use("Agg")
# a shell that starts the tests in the background has interrupts ignored, and every process that they start inherits that
signal.signal(signal.SIGINT, signal.default_int_handler)


BEGAN = time.monotonic()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--budget", type=float, help="seconds after which slow tests that have not begun are skipped")


def pytest_runtest_setup(item: pytest.Item) -> None:
    budget = item.config.getoption("--budget")
    if budget is not None and item.get_closest_marker("slow") and time.monotonic() - BEGAN > budget:
        pytest.skip(f"the time budget of {budget:g} s is spent")


@pytest.fixture(scope="session")
def beam() -> Structure:
    return load_structure("beam")


@pytest.fixture(scope="session")
def fe(beam: Structure) -> FeModel:
    return build_fe_model(beam)


@pytest.fixture(scope="session")
def composite(beam: Structure) -> Plant:
    return build_plant(beam, "composite")


@pytest.fixture(scope="session")
def modal(beam: Structure) -> Plant:
    return build_plant(beam, "modal")


@pytest.fixture(scope="session")
def laboratory() -> Hardware:
    return load_hardware()


@pytest.fixture(scope="module")
def quick_layout() -> Iterator[None]:
    """Move nothing apart in figures while a page is written: that takes longer than what the page shows.

    How figures look is tested in tests/views/test_views_figures.py.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: {})
        yield
