"""The main job: a T-bone steak of three materials falls on rigid things and is filmed, plotted and logged.

Run `python examples/steak.py --out out`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco

import mjframes as mf
from mjframes.app.recording import Recording, summary
from mjframes.app.run import record

MODELS = Path(__file__).parent.parent / "models"


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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    print(summary(run(parser.parse_args().out)))
