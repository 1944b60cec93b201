"""Fixtures shared by all tests."""

import os
import random
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pytest_addoption(parser):
    parser.addoption(
        "--until",
        type=float,
        metavar="T",
        help="files in an order drawn from T (Unix time, s); what would begin later is left out",
    )


def pytest_collection_modifyitems(config, items):
    """Where time may be short each file has its turn to be first."""
    until = config.getoption("until")
    if until is not None:
        files = sorted({str(item.path) for item in items})
        random.Random(until).shuffle(files)
        items.sort(key=lambda item: files.index(str(item.path)))


def pytest_runtest_setup(item):
    until = item.config.getoption("until")
    if until is not None and time.time() > until:
        pytest.skip("no time is left for it")


@pytest.fixture(scope="session")
def shared_data():
    """The folder of reference data: BSP_GP_DATA, by default ../shared/data beside the checkout."""
    folder = Path(os.environ.get("BSP_GP_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no reference data in {folder}; set BSP_GP_DATA to their folder")
    return folder
