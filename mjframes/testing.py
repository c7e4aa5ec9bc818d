"""Tests of what a scene looks like, against golden pictures; for pytest by the fixture `golden` of `pytest_mjframes`.

A golden is a PNG: on the left what MuJoCo draws, on the right which kinematic tree or skin each pixel shows, in colours
of their own. Two of them are alike when every silhouette is, by intersection over union and by its mean colour, and the
pictures are by structural similarity (Wang et al. 2004), in the whole and within the silhouettes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from skimage.io import imread, imsave
from skimage.metrics import structural_similarity

from mjframes.app.dented import draw_dents
from mjframes.app.video import find_camera, make_renderer
from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing

SIZE = (320, 240)  # [pixels] of a picture
# What Mesa draws by EGL and by OSMesa is the same to the pixel; other drivers may differ along edges
LEAST_IOU = 0.97  # [-] of silhouettes: less than half a pixel around one of 60 pixels
LEAST_SSIM = 0.95  # [-]
MOST_COLOR = 0.02  # [-] of full intensity, between mean colours of a silhouette
SMALL = 40  # [pixels] a silhouette that is smaller in both is too uncertain to compare

Picture = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen of a scene.

    picture: (height, width, 3).
    labels: (height, width): which silhouette a pixel belongs to; 0 is what is fixed to the world.
    """

    picture: Picture
    labels: NDArray[np.uint8]


@dataclass(frozen=True)
class Likeness:
    """How alike two sights are.

    iou: the least intersection over union of a silhouette.  ssim: the structural similarity, the lesser of the whole
    picture's and that within the silhouettes.  color: the greatest difference of a silhouette's mean colour [-].
    """

    iou: float
    ssim: float
    color: float

    @property
    def failures(self) -> tuple[str, ...]:
        """Which of the three are beyond their thresholds, in words."""
        found = {
            f"silhouettes agree by {self.iou:.3f}, at least {LEAST_IOU} is wanted": self.iou < LEAST_IOU,
            f"structural similarity is {self.ssim:.3f}, at least {LEAST_SSIM} is wanted": self.ssim < LEAST_SSIM,
            f"mean colours differ by {self.color:.3f}, at most {MOST_COLOR} is wanted": self.color > MOST_COLOR,
        }
        return tuple(sentence for sentence, wrong in found.items() if wrong)


@dataclass(frozen=True)
class Goldens:
    """Golden pictures.

    folder: of the goldens.  failures: folder of the pictures of those that fail, `<name>.failed.png`.
    update: write the goldens instead of comparing.
    """

    folder: Path
    failures: Path
    update: bool = False

    def __call__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        name: str,
        camera: str | mujoco.MjvCamera | None = None,
        times: Sequence[float] | None = None,
        control: Callable[[mujoco.MjData], None] | None = None,
    ) -> None:
        """Compare a scene with its goldens at some times.

        camera: name, or one of MuJoCo's; the scene's first unless given.
        times: of the simulation [s], ascending; unless given, the state is seen as it is.  control: is called before
        every step until the last of them.
        Raise AssertionError, with the measures and the path of a picture golden | got | difference, for what is not
        alike and for a golden that is missing; MjframesError for times that do not ascend, and where drawing fails.
        """
        if times is None:
            self._compare(see(model, data, camera), name)
            return
        for time in times:
            if time < data.time - model.opt.timestep / 2:
                raise MjframesError(
                    f"times have {time:g} s, but the simulation is at {data.time:g} s; let them ascend."
                )
            while data.time < time - model.opt.timestep / 2:
                if control is not None:
                    control(data)
                mujoco.mj_step(model, data)
            self._compare(see(model, data, camera), f"{name}-{time:g}s")

    def _compare(self, got: Sight, name: str) -> None:
        path, failed = self.folder / f"{name}.png", self.failures / f"{name}.failed.png"
        if self.update:
            save(got, path)
            failed.unlink(missing_ok=True)
            return
        if not path.exists():
            save(got, failed)
            raise AssertionError(f"{path}: there is no such golden; see {failed}, and write it by --update-goldens.")
        golden = load(path)
        if golden.picture.shape != got.picture.shape:
            raise AssertionError(f"{path}: the golden has another size; write it again by --update-goldens.")
        if failures := likeness(golden, got).failures:
            _save(side_by_side(golden, got), failed)
            raise AssertionError(f"{name} is not what it was: {'; '.join(failures)}; see {failed}.")
        failed.unlink(missing_ok=True)


def see(model: mujoco.MjModel, data: mujoco.MjData, camera: str | mujoco.MjvCamera | None = None) -> Sight:
    """Return what a camera sees of the state of `data`, whose positions are brought up to it."""
    mujoco.mj_forward(model, data)
    view = camera if isinstance(camera, mujoco.MjvCamera) else find_camera(model, camera)
    renderer = make_renderer(model, *SIZE)
    try:
        renderer.update_scene(data, camera=view)
        draw_dents(model, data, renderer.scene)
        picture = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        segments = np.asarray(renderer.render())
    finally:
        renderer.close()
    return Sight(picture, _silhouettes(model, segments[..., 0], segments[..., 1]))


def likeness(golden: Sight, got: Sight) -> Likeness:
    """Return how alike two sights of one size are."""
    ious, colors = [1.0], [0.0]
    for label in set(np.unique(golden.labels)) | set(np.unique(got.labels)):
        one, other = golden.labels == label, got.labels == label
        if label == 0 or max(one.sum(), other.sum()) < SMALL:
            continue
        ious.append((one & other).sum() / (one | other).sum())
        if one.any() and other.any():
            difference = golden.picture[one].mean(axis=0) - got.picture[other].mean(axis=0)
            colors.append(float(np.abs(difference).max()) / 255)
    compared: Any = structural_similarity(golden.picture, got.picture, channel_axis=2, data_range=255, full=True)
    whole, local = compared
    within = (golden.labels > 0) | (got.labels > 0)
    ssim = min(float(whole), float(local[within].mean())) if within.any() else float(whole)
    return Likeness(float(min(ious)), ssim, max(colors))


def side_by_side(golden: Sight, got: Sight) -> Picture:
    """Return golden | got | difference, each above its silhouettes; where they agree the difference is white."""
    difference = 255 - np.abs(golden.picture.astype(int) - got.picture).astype(np.uint8)
    wrong = np.where((golden.labels != got.labels)[..., None], 0, 255) * np.ones(3, int)
    rows = [golden.picture, got.picture, difference], [_colored(golden.labels), _colored(got.labels), wrong]
    return np.vstack([np.hstack(row) for row in rows]).astype(np.uint8)


def save(sight: Sight, path: Path) -> None:
    """Write a golden.  Raise MjframesError where it cannot be written."""
    _save(np.hstack([sight.picture, _colored(sight.labels)]), path)


def load(path: str | os.PathLike[str]) -> Sight:
    """Return a golden that `save` wrote.  Raise MjframesError for another file."""
    try:
        both = np.asarray(imread(path))
    except (OSError, ValueError) as error:
        raise MjframesError(f"{path}: the golden cannot be read ({error}).") from error
    if both.ndim != 3 or both.shape[1] % 2 or both.shape[2] != 3:
        raise MjframesError(f"{path}: this is no golden; write it again by --update-goldens.")
    picture, colored = np.split(both, 2, axis=1)
    labels = (colored[..., None, :] == COLORS).all(axis=-1)
    if not labels.any(axis=-1).all():
        raise MjframesError(f"{path}: this is no golden; write it again by --update-goldens.")
    return Sight(picture, labels.argmax(axis=-1).astype(np.uint8))


# of the silhouettes, so that neighbours differ; what is fixed to the world is black
COLORS = np.array(
    [
        (0, 0, 0), (230, 25, 75), (60, 180, 75), (255, 225, 25), (0, 130, 200), (245, 130, 48), (145, 30, 180),
        (70, 240, 240), (240, 50, 230), (210, 245, 60), (250, 190, 212), (0, 128, 128), (170, 110, 40),
    ],
    np.uint8,
)  # fmt: skip


def _colored(labels: NDArray[np.uint8]) -> Picture:
    return COLORS[labels]


def _silhouettes(model: mujoco.MjModel, number: np.ndarray, kind: np.ndarray) -> NDArray[np.uint8]:
    """Return the label of each pixel: one for each skin, then for each kinematic tree; in turn where there are many.

    number, kind: (height, width) of the object that is seen, as MuJoCo's segmentation has them.
    """
    roots = np.unique(model.body_rootid[model.body_weldid != 0])
    of_body = np.zeros(model.nbody, int)
    of_body[model.body_weldid != 0] = (
        np.searchsorted(roots, model.body_rootid[model.body_weldid != 0]) + model.nskin + 1
    )
    labels = np.zeros(number.shape, int)
    skins, geoms = kind == mujoco.mjtObj.mjOBJ_SKIN, kind == mujoco.mjtObj.mjOBJ_GEOM
    labels[skins] = number[skins] + 1
    labels[geoms] = of_body[model.geom_bodyid[number[geoms]]]
    seen = labels > 0
    labels[seen] = (labels[seen] - 1) % (len(COLORS) - 1) + 1
    return labels.astype(np.uint8)


def _save(picture: Picture, path: Path) -> None:
    with replacing(path, "the picture") as partial:
        imsave(partial, picture, check_contrast=False)
