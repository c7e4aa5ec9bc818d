"""The pytest plugin of mjframes: the fixture `golden`, and `--update-goldens`.

It is no part of the package `mjframes`, whose import loads MuJoCo: pytest imports its plugins also where they are not
used.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from mjframes.testing import Goldens


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mjframes")
    group.addoption("--update-goldens", action="store_true", help="write the golden pictures instead of comparing")
    parser.addini("golden_folder", "folder of the golden pictures (default: goldens, beside the test)", default="")


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Goldens:
    """Compare a scene with golden pictures: `golden(model, data, "steak", camera="front", times=(0.0, 0.2))`."""
    from mjframes.testing import Goldens

    chosen = request.config.getini("golden_folder")
    folder = request.config.rootpath / chosen if chosen else Path(request.path).parent / "goldens"
    return Goldens(folder, folder, update=bool(request.config.getoption("--update-goldens")))
