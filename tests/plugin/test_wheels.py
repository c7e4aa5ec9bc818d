"""How wheels are made: for which releases, with what names. `make check-wheels` looks at the wheels themselves."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheels() -> ModuleType:
    specification = importlib.util.spec_from_file_location("wheels", ROOT / "plugin" / "wheels.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_every_final_release_that_the_dependency_allows_has_a_library(wheels: ModuleType) -> None:
    requirement = wheels.mujoco_requirement()
    answer = "mujoco (4.0.0)\nAvailable versions: 4.2.0, 4.1.0rc1, 4.0.10, 4.0.9, 4.0.0, 3.18.0, 3.17.0, 3.16.0\n"
    found = [str(release) for release in wheels.allowed_releases(answer, requirement)]
    assert found == ["3.17.0", "3.18.0", "4.0.0", "4.0.9", "4.0.10"]


def test_an_index_that_lists_nothing_is_told(wheels: ModuleType) -> None:
    with pytest.raises(SystemExit, match=r"^pip index versions mujoco lists no versions: ERROR: No matching"):
        wheels.allowed_releases("ERROR: No matching distribution found for mujoco", wheels.mujoco_requirement())


def test_where_mujocos_library_is_in_a_package_of_its_own_that_is_fetched(wheels: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "mujoco-4.0.0.dist-info").mkdir()
    (tmp_path / "mujoco-4.0.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.4\nName: mujoco\nRequires-Dist: glfw\nRequires-Dist: mujoco-core==4.0.0\n"
        'Requires-Dist: mujoco-usd==4.0.0; extra == "usd"\n\nmujoco-core is text here.\n'
    )
    assert wheels.parts_of_mujoco(tmp_path) == ["mujoco-core==4.0.0"]


def test_the_compiler_is_told_processor_and_glibc(wheels: ModuleType) -> None:
    for processor in wheels.PROCESSORS:
        command = wheels.compiler(processor)["CXX"]
        assert command == f"{sys.executable} -m ziglang c++ -target {processor}-linux-gnu.{wheels.GLIBC}"


def test_a_command_that_fails_is_named(wheels: ModuleType) -> None:
    with pytest.raises(SystemExit, match="failed with 3: "):
        wheels.run(sys.executable, "-c", "raise SystemExit(3)")
