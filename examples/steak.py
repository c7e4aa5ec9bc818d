"""The main job: a T-bone steak of three materials falls on rigid things and is filmed, plotted and logged.

Run `python examples/steak.py --out out`. `--picture models/steak.webp` writes the README's moving picture instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

import mjframes as mf
from mjframes.app.recording import Recording, summary
from mjframes.app.run import record
from mjframes.app.video import painter
from mjframes.base.files import replacing

MODELS = Path(__file__).parent.parent / "models"
SHOWN, SLOWER, SHOWN_RATE = 1.0, 3.5, 20  # [s] of the moving picture, how many times slower it is, pictures a second
SHOWN_SIZE, SHOWN_QUALITY, LAST = (560, 350), 60, 1500  # [pixels], of WebP, [ms] for which the last picture stays
VEINS = {"flesh": (0.86, 0.58, 0.5), "bone": (0.8, 0.66, 0.55), "fat": (0.93, 0.78, 0.63)}  # colours, by material
VEIN_SPACING = 0.03  # [m] between veins, about
TEXELS = (256, 3)  # a gradient is round its middle, which only an odd number of rows has
DIGITS = 3  # of texture coordinates in XML: finer than texels
GLOSS = {"specular": 0.3, "shininess": 0.4}  # [-] what has veins is moist
SHARPNESS = 5.0  # [-] of |pattern| = 1 at the edge of a vein of mean width
UNEVEN = 1.3  # [-] natural logarithm of the ratio of the widest veins to the mean ones
COARSE, ASIDE = 2.3, 0.013  # [-], [m] the pattern that tells how wide veins are is larger, and lies elsewhere
# of four waves that bend each other: directions (4, 3), phases, and how often a wave turns while it bends another
DIRECTIONS = np.array([(0.64, 0.43, 0.64), (-0.51, 0.78, 0.36), (0.29, -0.56, 0.78), (0.84, -0.39, -0.38)])
PHASES, BENDS = np.array([0.3, 1.7, 4.1, 2.6]), np.array([0.7, 1.3, 0.4, 2.1])
BEND, TURNS = 1.6, np.array([1.2, 1.1, 0.9, 1.0])


def steak_scene(frames: int = 3) -> mujoco.MjSpec:
    """The kitchen with a steak above the block."""
    volume = mf.Volume.load(MODELS / "steak.npz")
    body = mf.build(volume, frames=frames, damping=(0.0, 0.01))
    spec = mujoco.MjSpec.from_file(str(MODELS / "kitchen.xml"))
    mf.attach(spec, body, "steak", pos=(0.0, 0.0, 0.15), quat=(0.996, 0.03, -0.07, 0.0))
    draw_veins(spec, "steak", VEINS)
    return spec


def draw_veins(spec: mujoco.MjSpec, name: str, colors: Mapping[str, Sequence[float]]) -> None:
    """Draw veins on the skins of soft body `name`, of these colours by material, where a smooth pattern crosses zero.

    The texture is one of MuJoCo's gradients, so that the scene stays one file: from the veins' colour at u = ½ to the
    skin's at 0 and 1.
    """
    for skin in spec.skins:
        before, _, material = skin.name.partition(":")
        if before != name or material not in colors:
            continue
        spec.add_texture(
            name=skin.name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=colors[material],
            rgb2=skin.rgba[:3],
            width=TEXELS[0],
            height=TEXELS[1],
        )
        made = spec.add_material(name=skin.name, rgba=(1, 1, 1, skin.rgba[3]), **GLOSS)
        textures = list(made.textures)
        textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = skin.name
        made.textures = textures
        skin.rgba = (0.5, 0.5, 0.5, 1)  # MuJoCo's default: it takes another one before that of the material
        skin.material = skin.name
        skin.texcoord = vein_coordinates(np.reshape(skin.vert, (-1, 3)), VEIN_SPACING).ravel()


def vein_coordinates(points: np.ndarray, spacing: float) -> np.ndarray:
    """Return texture coordinates (s, 2) of points (s, 3) at rest [m], where veins are about `spacing` [m] apart."""
    wide = _pattern(points[:, [1, 2, 0]] + ASIDE, COARSE * spacing)
    across = SHARPNESS * _pattern(points, spacing) * np.exp(-UNEVEN * wide)
    along = np.round(0.5 + 0.5 * np.clip(across, -1, 1), DIGITS)
    return np.stack([along, np.full(len(points), 0.5)], axis=1)


def _pattern(points: np.ndarray, spacing: float) -> np.ndarray:
    """Smooth irregularity (s,) between −2 and 2: a fixed sum of waves instead of random numbers."""
    phase = 2 * np.pi / spacing * (points @ DIRECTIONS.T)
    bend = np.sin(TURNS * phase + BENDS)
    return np.sin(phase + BEND * np.roll(bend, -1, axis=1) + PHASES).sum(axis=1) / 2


def run(out: Path, duration: float = 4.0) -> Recording:
    """Write steak.xml, steak.mp4, steak.png and steak.mcap to `out`."""
    out.mkdir(parents=True, exist_ok=True)
    spec = steak_scene()
    model = spec.compile()
    (out / "steak.xml").write_text(spec.to_xml())
    return record(
        model,
        duration,
        video=out / "steak.mp4",
        plot=out / "steak.png",
        log=out / "steak.mcap",
        camera="front",
        scene=spec,
        progress=True,
    )


def picture(path: Path, duration: float = SHOWN) -> int:
    """Write the fall as an animated WebP, slowed down; return how many pictures it has."""
    model = steak_scene().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pictures = []
    with painter(model, "above", SHOWN_SIZE) as paint:
        while data.time < duration:
            if data.time * SLOWER * SHOWN_RATE >= len(pictures):
                pictures.append(Image.fromarray(paint(data).copy()))
            mujoco.mj_step(model, data)
    each = [1000 // SHOWN_RATE] * (len(pictures) - 1) + [LAST]
    first, *others = pictures
    looks = {"duration": each, "loop": 0, "quality": SHOWN_QUALITY, "method": 6}
    with replacing(path, "the picture") as partial:
        first.save(partial, "WEBP", save_all=True, append_images=others, **looks)
    return len(pictures)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    parser.add_argument("--picture", type=Path, help="WebP to write instead")
    arguments = parser.parse_args()
    if arguments.picture:
        print(f"{arguments.picture}: {picture(arguments.picture)} pictures")
    else:
        print(summary(run(arguments.out)))
