"""The plan of the package and of its benchmarks: folders in order, imports to earlier ones only, and no ring."""

from __future__ import annotations

import ast
import re
import tomllib
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
    "cli",
]
BENCHMARKS = ROOT / "benchmarks"
ROOMS = {  # of the benchmarks, and what each imports of the others
    "solids": set[str](),
    "contenders": {"solids"},
    "speed": {"solids", "contenders"},
    "accuracy": {"solids", "contenders", "speed"},
    "stability": set[str](),
}
OUTSIDE = {"benchmarks", "docs", "examples", "plugin", "tests"}  # folders of a checkout that are not installed


def modules(package: Path) -> dict[str, Path]:
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in sorted(package.rglob("*.py"))}
    return {name.removesuffix(".__init__"): path for name, path in paths.items()}


def names_in(tree: ast.AST) -> set[str]:
    """What is imported, at the top, in a function or by `import_module`: modules, names with their modules."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = ast.unparse(node.func).rpartition(".")[2]
            if called in ("import_module", "__import__", "run_module"):
                found.add(str(node.args[0].value))
    return found


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """The modules that one imports; not for types alone."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    return {name if name in known else name.rpartition(".")[0] for name in names_in(tree)} & known.keys()


def folder(module: str, known: dict[str, Path]) -> str | None:
    """Where a module is; None for one at the top."""
    parts = module.split(".")
    return parts[1] if len(parts) > 2 or (known[module].name == "__init__.py" and len(parts) == 2) else None


def test_every_folder_is_a_stage() -> None:
    assert sorted(ORDER) == sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists())


def test_stages_import_earlier_ones_only() -> None:
    known = modules(PACKAGE)
    later = [
        f"{module} imports {other}"
        for module, path in known.items()
        for other in imported(path, known)
        if (own := folder(module, known)) and (its := folder(other, known)) and ORDER.index(its) > ORDER.index(own)
    ]
    assert not later, later


def test_no_module_imports_itself_by_way_of_others() -> None:
    known = modules(PACKAGE)
    TopologicalSorter({module: imported(path, known) - {module} for module, path in known.items()}).prepare()


def test_nothing_that_is_installed_imports_what_is_not() -> None:
    packages = [ROOT / name for name in packaged()]
    paths = [path for package in packages for path in sorted(package.rglob("*.py"))]
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in paths
        for name in names_in(ast.parse(path.read_text()))
        if name.partition(".")[0] in OUTSIDE
    ]
    assert not wrong, wrong


def packaged() -> list[str]:
    """What a wheel takes of the checkout's Python."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["scikit-build"]["wheel"]["packages"]


def test_a_wheel_has_no_benchmarks() -> None:
    assert packaged() == ["mjframes", "pytest_mjframes"]
    assert not [path for name in packaged() for path in (ROOT / name).rglob("benchmarks*")]
    assert (BENCHMARKS / "__init__.py").is_file()


def test_rooms_of_the_benchmarks_import_what_the_plan_says() -> None:
    known = modules(BENCHMARKS)
    assert {path.name for path in BENCHMARKS.iterdir() if (path / "__init__.py").exists()} == ROOMS.keys()
    wrong = [
        f"{module} imports {other}"
        for module, path in known.items()
        for other in imported(path, known)
        if (own := folder(module, known)) != (its := folder(other, known))
        and its not in ROOMS.get(str(own), set()) | {None}
    ]
    assert not wrong, wrong
    TopologicalSorter({module: imported(path, known) - {module} for module, path in known.items()}).prepare()


def test_the_package_lists_its_stages_in_order() -> None:
    rows = re.findall(r"^\| `(\w+)/` \|", (PACKAGE / "README.md").read_text(), re.MULTILINE)
    assert rows == ORDER


def test_no_class_of_the_package_has_the_name_of_another() -> None:
    homes: dict[str, list[str]] = {}
    for module, path in modules(PACKAGE).items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                homes.setdefault(node.name, []).append(module)
    assert not {name: found for name, found in homes.items() if len(found) > 1}


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
