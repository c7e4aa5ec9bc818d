"""Films and stills of a simulation: MuJoCo's offscreen renderer, films in H.264."""

from __future__ import annotations

import importlib
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from ctypes import CDLL
from fractions import Fraction
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.app.dented import draw_dents
from mjframes.base.errors import MjframesError, reason
from mjframes.base.files import replacing
from mjframes.base.packages import optional
from mjframes.scene.load import require_model, require_state

QUALITY = {"crf": "20", "preset": "veryfast"}  # of x264: no visible loss, and faster than the drawing
# As Foxglove needs it: a picture a packet, in order, one a second that can be decoded without those before; x264's own
# default of quality, as films of a log are drawn from its states
LIVE = {**QUALITY, "crf": "23", "bf": "0", "x264-params": "repeat-headers=1:annexb=1"}

Picture = NDArray[np.uint8]


@contextmanager
def painter(
    model: mujoco.MjModel, camera: str | mujoco.MjvCamera | None = None, size: tuple[int, int] = (1280, 720)
) -> Iterator[Callable[[mujoco.MjData], Picture]]:
    """A function that draws a state as a picture (height, width, 3); arguments as of `still`."""
    view = camera if isinstance(camera, mujoco.MjvCamera) else find_camera(model, camera)
    renderer = make_renderer(model, *size)

    def paint(data: mujoco.MjData) -> Picture:
        renderer.update_scene(data, view)
        draw_dents(model, data, renderer.scene)
        return renderer.render()

    try:
        yield paint
    finally:
        renderer.close()


@contextmanager
def movie(path: str | os.PathLike[str], fps: float, size: tuple[int, int]) -> Iterator[Callable[[Picture], None]]:
    """A function that adds a picture as a frame; arguments, the file and what is raised as of `film`."""
    av = _pyav(fps, size)
    if Path(path).suffix.lower() not in (".mp4", ".mkv", ".mov"):
        raise MjframesError(f"{path}: a video is written as .mp4, .mkv or .mov; give the path one of these endings.")
    with (
        replacing(path, "the video") as partial,
        av.open(str(partial), "w", options={"movflags": "+faststart"}) as container,
    ):
        stream = container.add_stream("libx264", rate=_rate(fps), options=QUALITY)
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        yield lambda picture: container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


def packets(fps: float, size: tuple[int, int]) -> Callable[[Picture | None], list[bytes]]:
    """Return a function that encodes one picture after the other as H.264 in Annex B; arguments as of `film`.

    It returns the packets, one a picture, that are ready: x264 looks some pictures ahead. None for a picture ends it.
    Raise MjframesError as `film` does.
    """
    av = _pyav(fps, size)
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height = size
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = _rate(fps), 1 / _rate(fps)
    codec.gop_size = max(1, round(fps))
    codec.options = LIVE

    def encode(picture: Picture | None) -> list[bytes]:
        frame = None if picture is None else av.VideoFrame.from_ndarray(picture, format="rgb24")
        return [bytes(packet) for packet in codec.encode(frame)]

    return encode


@contextmanager
def film(
    model: mujoco.MjModel,
    path: str | os.PathLike[str],
    *,
    camera: str | None = None,
    fps: float = 30.0,
    size: tuple[int, int] = (1280, 720),
) -> Iterator[Callable[[mujoco.MjData], None]]:
    """Open a film, in a `with` block. The file appears when the block succeeds.

    Parameters
    ----------
    model
        The compiled model.
    path
        File (.mp4, .mkv or .mov).
    camera
        Name of a camera. The default is the scene's first one, or MuJoCo's free camera if there is none.
    fps
        Frames per second.
    size
        Width and height [pixels], even numbers.

    Yields
    ------
    callable
        Adds the state of an `MjData` as a frame.

    Raises
    ------
    MjframesError
        For an unknown camera, for a size or rate that cannot be, and if drawing or writing fails.
    """
    require_model(model)
    with movie(path, fps, size) as add, painter(model, camera, size) as paint:
        yield lambda data: add(paint(data))


def still(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: str | mujoco.MjvCamera | None = None,
    size: tuple[int, int] = (1280, 720),
) -> NDArray[np.uint8]:
    """Return a picture of the present state.

    Parameters
    ----------
    model, data
        The compiled model and its state.
    camera
        Name of a camera, or one made by `look_from`. The default is the scene's first one, or MuJoCo's free camera if
        there is none.
    size
        Width and height [pixels].

    Returns
    -------
    array
        Picture (height, width, 3) of 8-bit RGB.

    Raises
    ------
    MjframesError
        For an unknown camera, and if drawing fails.
    """
    require_state(model, data)
    with painter(model, camera, size) as paint:
        return paint(data)


def look_from(lookat: Sequence[float], distance: float, azimuth: float, elevation: float) -> mujoco.MjvCamera:
    """Return a camera that looks at a point, for `still`.

    Parameters
    ----------
    lookat
        The point (3,) [m].
    distance
        Distance of the camera from it [m].
    azimuth, elevation
        Direction in which the camera looks [degrees], as in MuJoCo.
    """
    camera = mujoco.MjvCamera()
    camera.lookat[:] = lookat
    camera.distance, camera.azimuth, camera.elevation = distance, azimuth, elevation
    return camera


def find_camera(model: mujoco.MjModel, name: str | None) -> int:
    """Number of a camera, the first unless named, −1 (free) where there is none.  Raises MjframesError if unknown."""
    names = [model.camera(k).name for k in range(model.ncam)]
    if name is None:
        return 0 if names else -1
    if name not in names:
        known = f"its cameras are {', '.join(filter(None, names))}" if any(names) else "it has no named cameras"
        raise MjframesError(f"camera {name!r} is not in the scene; {known}.")
    return names.index(name)


def make_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """MuJoCo's renderer, without a display too; raises the model's offscreen buffer to the size [pixels].

    Raises MjframesError where there is no OpenGL.
    """
    _choose_backend()
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    try:
        return mujoco.Renderer(model, height, width)
    except Exception as error:  # every backend fails in its own way
        raise MjframesError(
            f"MuJoCo cannot draw here with MUJOCO_GL={os.environ.get('MUJOCO_GL', '')} ({reason(error)}); "
            "set MUJOCO_GL to egl or osmesa and install its library (Debian: apt-get install libegl1 libgl1)."
        ) from error


def has_display() -> bool:
    """Whether windows can open; beyond Linux that is taken for granted."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _pyav(fps: float, size: tuple[int, int]) -> ModuleType:
    """PyAV, for films that can be.  Raises MjframesError for others, and where it is missing."""
    av = optional("av", "a video", "video", "PyAV")
    if not all(side >= 16 and side % 2 == 0 for side in size):
        raise MjframesError(f"size is {size[0]}x{size[1]}; a video needs even numbers of pixels, 16 or more.")
    if not (math.isfinite(fps) and 0 < fps <= 1000):
        raise MjframesError(f"fps is {fps!r}; it must be a number of frames a second between 0 and 1000.")
    return av


def _rate(fps: float) -> Fraction:
    return Fraction(fps).limit_denominator(1001)


def _choose_backend() -> None:
    """Set MUJOCO_GL where it is unset and there is no display: EGL, or else OSMesa."""
    if os.environ.get("MUJOCO_GL") or has_display():
        return
    try:
        CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"
    except OSError:
        os.environ["MUJOCO_GL"] = "osmesa"
    # MuJoCo has read the variable when it was imported, and its renderer looks here for what came of it
    importlib.reload(importlib.import_module("mujoco.rendering.classic.gl_context"))
