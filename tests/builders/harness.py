"""Parts of the plugin, compiled with its own flags and without MuJoCo, called as C functions."""

from __future__ import annotations

import ctypes
import hashlib
import subprocess
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from mjframes.base.files import cache_directory, replacing
from mjframes.elasticity.laws import LawParameters
from mjframes.scene import plugin

SOURCES = Path(__file__).parents[2] / "plugin"


@cache
def harness(part: str = "quadrature") -> ctypes.CDLL:
    """The functions of quadrature_harness.cc or another part's, made once for these sources."""
    units = [Path(__file__).with_name(f"{part}_harness.cc"), SOURCES / f"{part}.cc"]
    digest = hashlib.sha256(units[0].read_bytes() + plugin.library_name(SOURCES).encode()).hexdigest()[:12]
    library = cache_directory() / f"harness-{part}-{digest}.so"
    if not library.is_file():
        flags = (SOURCES / plugin.FLAGS_FILE).read_text().split()
        command = [
            *plugin.find_compiler(),
            *flags,
            "-Werror",
            f"-I{SOURCES}",
            "-isystem",
            mujoco.HEADERS_DIR + "/..",
            "-shared",
        ]
        with replacing(library, "the library") as file:
            subprocess.run([*command, *map(str, units), "-o", str(file)], check=True)
    loaded = ctypes.CDLL(str(library))
    if part == "quadrature":
        loaded.region.restype = ctypes.c_double
    return loaded


def pointer(array: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


def respond(p: LawParameters, F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Energy (q,), Cauchy stress (q, 3, 3), P (q, 3, 3) and projected ∂P/∂F (q, 9, 9) as the plugin has them."""
    F, constants = np.ascontiguousarray(F), np.array(p.constants)
    out = [np.zeros((len(F), *shape)) for shape in ((), (3, 3), (3, 3), (9, 9))]
    status = harness().respond(p.law.encode(), pointer(constants), len(F), pointer(F), *map(pointer, out))
    assert status == 0
    return out[0], out[1], out[2], out[3]


def region(
    p: list[LawParameters],
    material: np.ndarray,
    points: np.ndarray,
    gradient: np.ndarray,
    volume: np.ndarray,
    pair: np.ndarray,
    x: np.ndarray,
    force: np.ndarray,
    pair_stiffness: np.ndarray | None,
) -> float:
    """The energy of a region; adds to force (k, 3) and pair_stiffness (pairs, 3, 3)."""
    constants = np.array([some.constants for some in p])
    arrays = [np.ascontiguousarray(a, t) for a, t in ((material, np.int32), (points, np.int32), (pair, np.int32))]
    return harness().region(
        p[0].law.encode(), pointer(constants), pointer(arrays[0]), len(points), pointer(arrays[1]), len(volume),
        pointer(np.ascontiguousarray(gradient)), pointer(volume), pointer(arrays[2]),
        pointer(np.ascontiguousarray(x)), pointer(force), pointer(pair_stiffness),
    )  # fmt: skip


def signed_svd(F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U, σ, V of F (q, 3, 3), q a multiple of four."""
    F = np.ascontiguousarray(F)
    U, sigma, V = np.zeros_like(F), np.zeros((len(F), 3)), np.zeros_like(F)
    harness().signed_svd(len(F), *map(pointer, (F, U, sigma, V)))
    return U, sigma, V
