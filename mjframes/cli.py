"""The command line: `mjframes build`, `run`, `view`, `doctor`.

A mistake of the user ends in one sentence on stderr and exit code 2; files appear whole or not at all.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from mjframes.errors import MjframesError
from mjframes.material import Material


class Parser(argparse.ArgumentParser):
    """argparse that reports a mistake as everything else here does."""

    def error(self, message: str) -> NoReturn:
        raise MjframesError(f"{message}; see {self.prog} --help.")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        arguments = _parser().parse_args(argv)
        return arguments.command(arguments)
    except MjframesError as error:
        print(f"mjframes: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mjframes: interrupted.", file=sys.stderr)
        return 130


def build(arguments: argparse.Namespace) -> int:
    """Label image in, soft body (.npz) or scene (.xml) out."""
    output = Path(arguments.output)
    if output.suffix.lower() not in (".npz", ".xml"):
        raise MjframesError(f"{output}: the output is a soft body (.npz) or a scene (.xml); give one of these endings.")
    materials = dict(map(parse_material, arguments.material)) or None

    import mujoco
    from rich.console import Console

    from mjframes.body import build as build_body
    from mjframes.files import replacing
    from mjframes.scene import standalone_scene
    from mjframes.volume import Volume

    start = time.perf_counter()
    console = Console(stderr=True)
    with replacing(output, "the output") as partial, console.status("reading the volume") as status:
        volume = Volume.from_labels(arguments.volume, spacing=arguments.spacing, materials=materials)
        body = build_body(
            volume, frames=arguments.frames, samples=arguments.samples, seed=arguments.seed, progress=status.update
        )
        status.update("writing")
        spec = standalone_scene(body, volume, contact=arguments.contact)
        try:
            model = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise MjframesError(f"MuJoCo cannot compile the soft body ({' '.join(str(error).split())}).") from error
        if output.suffix.lower() == ".npz":
            body.save(str(partial))
        else:
            partial.write_text(spec.to_xml(), encoding="utf-8")
    print(
        f"{output}: {len(body.parent)} frames, {len(body.fit_error)} samples, {body.voxels} voxels, "
        f"{model.nv} degrees of freedom, {len(body.skin.vertices)} vertices, {time.perf_counter() - start:.2f} s"
    )
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Step a scene; write video, log and plot; print what was measured."""
    from mjframes.run import load_scene, record, summary

    model, spec = load_scene(arguments.scene)
    recording = record(
        model,
        arguments.duration,
        video=arguments.video,
        log=arguments.log,
        plot=arguments.plot,
        camera=arguments.camera,
        fps=arguments.fps,
        size=arguments.size,
        scene=spec.to_xml() if arguments.log else "",
        progress=True,
    )
    print(summary(recording))
    return 0


def view(arguments: argparse.Namespace) -> int:
    """Open MuJoCo's viewer."""
    from mjframes.run import load_scene
    from mjframes.video import has_display

    model, _ = load_scene(arguments.scene)
    if not has_display():
        raise MjframesError("there is no display to open a window on; use mjframes run SCENE --video FILE.mp4 instead.")
    import mujoco.viewer

    mujoco.viewer.launch(model)
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """Print what is installed and whether it works."""
    from mjframes.doctor import main as examine

    return examine()


def parse_material(text: str) -> tuple[int, Material]:
    """(label, material) from "1=flesh:young=3e4,poisson=0.45,density=1050" or "2=bone:rigid,density=1900".

    The name is optional; rgba=0.8/0.3/0.3/1 sets the colour, the opacity may be left out.
    Raises MjframesError for anything else.
    """
    head, _, tail = text.partition(":")
    label, _, name = head.partition("=")
    entries = [entry.strip() for entry in tail.split(",") if entry.strip()]
    keys = {key.strip(): value for key, _, value in (entry.partition("=") for entry in entries) if key != "rigid"}
    rigid = "rigid" in entries
    wanted = {"density"} if rigid else {"young", "poisson", "density"}
    if not label.strip().isdecimal() or int(label) < 1 or set(keys) - {"rgba"} != wanted:
        raise MjframesError(
            f"--material {text!r} is not understood; write "
            "LABEL=NAME:young=PASCALS,poisson=RATIO,density=KG_PER_M3 or LABEL=NAME:rigid,density=KG_PER_M3."
        )
    name = name.strip()
    try:
        density = float(keys["density"])
        if rigid:
            material = Material.rigid(density, name=name)
        else:
            material = Material(float(keys["young"]), float(keys["poisson"]), density, name=name)
        if "rgba" in keys:
            red, green, blue, alpha = map(float, (keys["rgba"] + "/1").split("/")[:4])
            material = replace(material, rgba=(red, green, blue, alpha))
    except MjframesError:
        raise
    except ValueError as error:
        raise MjframesError(
            f"--material {text!r} has a value that is no number; colours are r/g/b or r/g/b/a."
        ) from error
    return int(label), material


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="mjframes", description="Soft bodies of several materials in MuJoCo, made of a few frames.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser("build", help="make a soft body or a scene from a label image")
    command.set_defaults(command=build)
    command.add_argument("volume", metavar="VOLUME", help="label image: .npz, .nrrd, .nii, .nii.gz; 0 is outside")
    command.add_argument("-o", "--output", required=True, metavar="FILE", help="soft body (.npz) or scene (.xml)")
    command.add_argument("--frames", type=_count, default=3, metavar="N", help="number of frames (default %(default)s)")
    command.add_argument(
        "--samples", type=_count, default=10, metavar="N", help="number of integration samples (default %(default)s)"
    )
    command.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="LABEL=NAME:KEY=VALUE,…",
        help="one for each label, unless the image carries them: "
        "1=flesh:young=3e4,poisson=0.45,density=1050 or 2=bone:rigid,density=1900; [Pa], [kg/m³]",
    )
    command.add_argument(
        "--spacing", type=_spacing, metavar="METRES", help="edge of a voxel, or three: 0.001,0.001,0.002"
    )
    command.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the frame placement (default %(default)s)"
    )
    command.add_argument("--no-contact", dest="contact", action="store_false", help="a scene without contact")

    command = commands.add_parser("run", help="step a scene; write a video, a log, a plot")
    command.set_defaults(command=run)
    command.add_argument("scene", metavar="SCENE", help="MJCF file (.xml)")
    command.add_argument("--duration", type=float, default=3.0, metavar="SECONDS", help="(default %(default)s)")
    command.add_argument("--video", metavar="FILE", help="film to write: .mp4, .mkv, .mov")
    command.add_argument("--log", metavar="FILE", help="log to write: .mcap, for Foxglove")
    command.add_argument("--plot", metavar="FILE", help="figure to write: .png, .pdf, .svg")
    command.add_argument("--camera", metavar="NAME", help="camera of the film (default: the scene's first)")
    command.add_argument("--fps", type=float, default=30.0, metavar="N", help="frames a second (default %(default)s)")
    command.add_argument(
        "--size", type=_size, default=(1280, 720), metavar="WxH", help="of the film (default 1280x720)"
    )

    command = commands.add_parser("view", help="open a scene in MuJoCo's viewer")
    command.set_defaults(command=view)
    command.add_argument("scene", metavar="SCENE", help="MJCF file (.xml)")

    command = commands.add_parser("doctor", help="tell what is installed and whether it works")
    command.set_defaults(command=doctor)
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def _spacing(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in (1, 3) or not all(math.isfinite(value) and value > 0 for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not one length in metres or three with commas between")
    return values * (3 // len(values))


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT in pixels")
    return int(width), int(height)


if __name__ == "__main__":
    sys.exit(main())
