"""The main job: a T-bone steak of three materials falls on rigid things and is filmed, plotted and logged.

Run `python examples/steak.py --out out`. `--picture models/steak.webp` writes the README's moving picture instead.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
from PIL import Image

import mjframes as mf
from mjframes.app.recording import Recording, summary
from mjframes.app.run import record
from mjframes.app.video import painter
from mjframes.base.files import replacing

MODELS = Path(__file__).parent.parent / "models"
SHOWN, SLOWER, SHOWN_RATE = 1.0, 3.5, 20  # [s] of the moving picture, how many times slower it is, pictures a second
SHOWN_SIZE, SHOWN_QUALITY, LAST = (560, 350), 60, 1500  # [pixels], of WebP, [ms] for which the last picture stays


def steak_scene(frames: int = 3) -> mujoco.MjSpec:
    """The kitchen with a steak above the block."""
    volume = mf.Volume.load(MODELS / "steak.npz")
    body = mf.build(volume, frames=frames, damping=(0.0, 0.01))
    spec = mujoco.MjSpec.from_file(str(MODELS / "kitchen.xml"))
    mf.attach(spec, body, "steak", pos=(0.0, 0.0, 0.15), quat=(0.996, 0.03, -0.07, 0.0))
    return spec


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
