"""What the documentation says: its snippets run, and it has all that is public."""

from __future__ import annotations

import inspect
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from builders.tiers import tiered

import mjframes as mf

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TRIED = {"first_hour", "learning", "medical_images", "robots", "troubleshooting"}  # pages whose commands run too
SNIPPET = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def snippets(page: Path) -> list[tuple[str, str]]:
    """Python, and mjframes' own commands, in the order of the page."""
    found = SNIPPET.findall(page.read_text(encoding="utf-8"))
    return [(kind, text) for kind, text in found if kind == "python" or page.stem in TRIED]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a reader has: the models, and the meshes and the robot that the pages name."""
    (tmp_path / "models").mkdir()
    for model in (ROOT / "models").iterdir():
        shutil.copy(model, tmp_path / "models")
    trimesh.creation.box((0.04, 0.02, 0.02)).export(tmp_path / "flesh.obj")
    trimesh.creation.box((0.02, 0.01, 0.01)).export(tmp_path / "bone.stl")
    trimesh.creation.box((30, 30, 10)).export(tmp_path / "pad.stl")  # [mm]
    (tmp_path / "robot.xml").write_text(
        "<mujoco><worldbody><body name='finger'><joint/><geom type='box' size='.02 .02 .01'/></body></worldbody>"
        "</mujoco>"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "page",
    tiered(filter(snippets, PAGES), lambda page: page.stem != "README"),
    ids=lambda page: page.stem,
)
def test_snippets_run_one_after_the_other(page: Path, folder: Path) -> None:
    if page.stem == "learning":
        pytest.importorskip("gymnasium")
    labels = np.ones((8, 8, 8), int)
    labels[3:5, 3:5] = 2
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    names: dict[str, object] = {"labels": labels, "__name__": page.stem}
    for kind, text in snippets(page):
        if kind == "python":
            start = page.read_text(encoding="utf-8").partition(text)[0].count("\n")  # tracebacks name lines of the page
            exec(compile("\n" * start + text, str(page), "exec"), names)
            if page.stem == "first_hour" and "task" in names:
                assert names["task"].force() == pytest.approx(5, abs=0.05)  # type: ignore[attr-defined]
            continue
        for line in text.splitlines():
            program, *arguments = shlex.split(line)
            assert program == "mjframes"
            command = [sys.executable, "-m", "mjframes", *arguments]
            done = subprocess.run(command, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, done.stdout + done.stderr


def test_the_readme_is_short() -> None:
    text = PAGES[0].read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert len(text.split()) <= 1200


def test_links_and_pictures_of_pages_exist() -> None:
    missing = []
    beside_code = [ROOT / folder / "README.md" for folder in ("mjframes", "plugin", "models")]
    for page in [*PAGES, *beside_code, ROOT / "CONTRIBUTING.md"]:
        text = SNIPPET.sub("", page.read_text(encoding="utf-8"))
        links = re.findall(r"\]\(([^)#\s]+)[^)]*\)|src=\"([^\"]+)\"|^:link: (\S+)$", text, re.MULTILINE)
        for link in ("".join(link) for link in links):
            drawn = link.startswith(("_pictures/", "_static/"))  # when the documentation is made, which fails without
            there = (page.parent / link).exists() or (page.parent / f"{link}.md").exists()  # cards name pages
            if not link.startswith("http") and not drawn and not there:
                missing.append(f"{page.name}: {link}")
    assert not missing, missing


def test_the_reference_has_all_that_is_public() -> None:
    documented = re.findall(r"^\.\. auto\w+:: mjframes\.(\w+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)
    assert sorted(documented) == sorted(mf.__all__)


@pytest.mark.parametrize("name", sorted(mf.__all__))
def test_docstrings_of_what_is_public_describe_every_parameter(name: str) -> None:
    """In numpydoc's sections, which editors show."""
    public = getattr(mf, name)
    if isinstance(public, type) and issubclass(public, BaseException):
        assert str(public.__doc__).endswith(".")
        return
    described = []
    _, _, section = str(inspect.getdoc(public)).partition("Parameters\n----------\n")
    for line in re.split(r"\n\n\w+\n-{3,}\n", section)[0].splitlines():
        if line and not line.startswith(" "):
            described += line.split(", ")
    assert sorted(described) == sorted(p for p in inspect.signature(public).parameters if not p.startswith("_"))


def test_formulas_need_no_accents_of_time_derivatives() -> None:
    """Browsers without a font for mathematics put the dots of \\dot beside the letter."""
    assert not [page.name for page in PAGES if re.search(r"\\d+ot\b", page.read_text(encoding="utf-8"))]


def test_films_of_the_gallery_begin_with_the_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("PIL", "dm_control", "av"):
        pytest.importorskip(module)
    import av

    monkeypatch.syspath_prepend(ROOT / "docs")
    from pictures import filmed  # type: ignore[import-not-found]

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><light pos='0 0 3'/><camera pos='0 0 2'/><body pos='0 0 .1'><freejoint/>"
        "<geom type='box' size='.3 .3 .1' rgba='1 0 0 1'/></body></worldbody></mujoco>"
    )
    with filmed(model, tmp_path / "box.mp4") as add:
        add(mujoco.MjData(model))
    with av.open(str(tmp_path / "box.mp4")) as film:
        first = next(film.decode(video=0)).to_ndarray(format="rgb24")  # type: ignore[call-overload]
    assert (first[..., 0] > first[..., 1].astype(int) + 50).sum() > 5000  # pixels of the box


def test_every_example_is_in_the_gallery() -> None:
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert not [path.name for path in (ROOT / "examples").glob("*.py") if f"`examples/{path.name}`" not in gallery]


def test_every_page_is_in_a_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = {line for block in re.findall(r"```{toctree}\n(.*?)```", index, re.DOTALL) for line in block.split()}
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} - {"index"} <= listed
