"""An interrupt that comes while trimesh is imported is not lost."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "mjframes"
HOME = PACKAGE / "base" / "trimeshes.py"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_trimesh_is_imported_comes_after_it(tmp_path: Path, number: signal.Signals) -> None:
    """networkx, which trimesh can do without, is one that gets a signal."""
    (tmp_path / "networkx.py").write_text(f"import signal\nsignal.raise_signal({int(number)})\nclass Graph: pass\n")
    program = f"""
import signal, sys
sys.path.insert(0, {str(tmp_path)!r})
def handler(number, frame):
    import trimesh.base
    print(int(number), trimesh.base.Graph.__name__, flush=True)
    raise SystemExit(7)
signal.signal({int(number)}, handler)
import mjframes.surface.isosurface
print("the signal was lost")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (7, f"{int(number)} Graph\n", "")


def test_trimesh_is_imported_in_one_place() -> None:
    importing = re.compile(r"(?<!TYPE_CHECKING:)\n *(import|from) trimesh\b")
    assert [path for path in PACKAGE.rglob("*.py") if importing.search(path.read_text())] == [HOME]
