"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data():
    """The folder of reference data: BSP_GP_DATA, by default ../shared/data beside the checkout."""
    folder = Path(os.environ.get("BSP_GP_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no reference data in {folder}; set BSP_GP_DATA to their folder")
    return folder
