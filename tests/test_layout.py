"""The plan of the package: folders in the order of the stages, imports to earlier ones only, and no ring."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "mjframes"
ROOT = PACKAGE.parent
ORDER = [
    "base",
    "volume",
    "frames",
    "weights",
    "kinematics",
    "finite_elements",
    "elasticity",
    "whole_body",
    "surface",
    "body",
    "scene",
    "app",
    "dm",
    "envs",
    "benchmarks",
    "cli",
]


def modules() -> dict[str, Path]:
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """The modules that one imports, at its top or in a function; not for types alone."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("mjframes"):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return {name for name in found if name in known}


def folder(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if len(parts) > 2 else None


def test_every_folder_is_a_stage() -> None:
    assert sorted(ORDER) == sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists())


def test_stages_import_earlier_ones_only() -> None:
    known = modules()
    later = [
        f"{module} imports {other}"
        for module, path in known.items()
        for other in imported(path, known)
        if folder(module) and folder(other) and ORDER.index(str(folder(other))) > ORDER.index(str(folder(module)))
    ]
    assert not later, later


def test_no_module_imports_itself_by_way_of_others() -> None:
    known = modules()
    TopologicalSorter({module: imported(path, known) - {module} for module, path in known.items()}).prepare()


def test_the_package_lists_its_stages_in_order() -> None:
    rows = re.findall(r"^\| `(\w+)/` \|", (PACKAGE / "README.md").read_text(), re.MULTILINE)
    assert rows == ORDER


def test_files_that_pages_name_are_there() -> None:
    pages = [
        PACKAGE / "README.md",
        ROOT / "plugin" / "README.md",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").glob("*.md"),
    ]
    missing = []
    for page in pages:
        for name in re.findall(r"`((?:[\w.]+/)*[\w.]+\.(?:py|cc|h))`", page.read_text()):
            homes = (ROOT, PACKAGE, page.parent, ROOT / "plugin")
            if not any((home / name).exists() for home in homes) and "/" in name:
                missing.append(f"{page.name}: {name}")
    assert not missing, missing


def test_no_test_imports_a_test() -> None:
    tests = sorted((ROOT / "tests").rglob("*.py"))
    assert not [
        str(path) for path in tests if re.search(r"^(from|import) (\w+\.)*test_", path.read_text(), re.MULTILINE)
    ]


def test_equations_of_the_paper_are_in_the_table() -> None:
    table = (PACKAGE / "README.md").read_text()
    assert [f"| ({number})" in table for number in range(1, 12)] == [True] * 11
