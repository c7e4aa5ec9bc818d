"""Pictures and films that were written, as tests look at them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from skimage.io import imread

LIKE = 0.99  # [-] cosine between two colours, about 8°: light and shadow make a colour brighter or darker, not another
DARK = 40  # [-] of 442: what is darker has no colour


def picture(path: Path) -> np.ndarray:
    """(height, width, 3) of a PNG, 0 to 255."""
    return np.asarray(imread(path))[..., :3]


def film(path: Path) -> list[np.ndarray]:
    """(height, width, 3) of each frame of a film, 0 to 255."""
    import av

    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def share(image: np.ndarray, color: str | tuple[float, float, float]) -> float:
    """Share of the pixels that have a colour, none of the greys: Matplotlib's name of it, or red, green and blue."""
    from matplotlib.colors import to_rgb

    wanted, length = np.array(to_rgb(color)), np.linalg.norm(image, axis=-1)
    return float(np.mean((image @ wanted > LIKE * length * np.linalg.norm(wanted)) & (length > DARK)))


def share_drawn(image: np.ndarray) -> float:
    """Share of the pixels that are not of the most frequent colour."""
    count = np.bincount((image.astype(int) @ [65536, 256, 1]).ravel())
    return 1 - count.max() / count.sum()
