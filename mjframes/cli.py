"""The command line: `mjframes build`, `inspect`, `run`, `view`, `bench`, `report`, `check`, `doctor`.

A mistake of the user ends in one sentence on stderr and exit code 2; files appear whole or not at all.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mjframes.arguments import command_line
from mjframes.errors import MjframesError, Notice

if TYPE_CHECKING:
    from mjframes.volume import Volume


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        arguments = command_line(COMMANDS).parse_args(argv)
        return arguments.command(arguments)
    except MjframesError as error:
        print(f"mjframes: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mjframes: interrupted.", file=sys.stderr)
        return 130


def build(arguments: argparse.Namespace) -> int:
    """Label image or meshes in, soft body (.npz) or scene (.xml) out."""
    output = Path(arguments.output)
    if output.suffix.lower() not in (".npz", ".xml"):
        raise MjframesError(f"{output}: the output is a soft body (.npz) or a scene (.xml); give one of these endings.")
    import mujoco
    from rich.console import Console

    from mjframes.body import build as build_body
    from mjframes.files import replacing
    from mjframes.inputs import METRES, Materials, parse_fill, parse_material, read_materials, read_volume
    from mjframes.scene import standalone_scene

    materials = read_materials(arguments.materials) if arguments.materials else Materials()
    materials = Materials(
        materials.by_label | dict(map(parse_material, arguments.material)),
        parse_fill(arguments.fill) if arguments.fill else materials.fill,
    )
    scale = METRES[arguments.unit] if arguments.unit else arguments.scale
    start = time.perf_counter()
    console = Console(stderr=True)
    with replacing(output, "the output") as partial, console.status("reading the volume") as status:
        with printed_notices():
            volume = read_volume(
                arguments.volume,
                materials,
                spacing=arguments.spacing,
                voxels=arguments.voxels,
                scale=scale,
                drop_unknown=arguments.drop_unknown,
            )
        if arguments.largest:
            volume = largest_piece(volume)
        body = build_body(
            volume,
            frames=arguments.frames or (None if arguments.error else 3),
            error=arguments.error,
            samples=arguments.samples,
            seed=arguments.seed,
            frame_type=arguments.frame_type,
            weights=arguments.weights,
            subdivisions=arguments.subdivisions,
            method=arguments.method,
            law=arguments.law,
            mass=arguments.mass,
            mode=arguments.mode,
            damping=arguments.damping,
            progress=status.update,
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
        f"{output}: {len(body.parent)} frames, {len(body.stiffness.points)} regions, {body.voxels} voxels, "
        f"{model.nv} degrees of freedom, {len(body.skin.vertices)} vertices, {time.perf_counter() - start:.2f} s"
    )
    if body.error:
        print(f"error: {body.error}")
    return 0


def inspect(arguments: argparse.Namespace) -> int:
    """Soft body in, pictures of what was precomputed out."""
    from rich.console import Console

    from mjframes.body import SoftBody
    from mjframes.inspect import draw_pictures

    start = time.perf_counter()
    asset = Path(arguments.asset)
    folder = Path(arguments.output) if arguments.output else asset.with_name(f"{asset.stem}-pictures")
    body = SoftBody.load(str(asset))
    with Console(stderr=True).status("drawing") as status:
        written = draw_pictures(body, folder, asset.name, lambda picture: status.update(f"drawing {picture}"))
    print(f"{folder}: {len(written)} pictures, {time.perf_counter() - start:.1f} s")
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


def report(arguments: argparse.Namespace) -> int:
    """Measure error and run time against finite elements and flex."""
    from rich.console import Console

    from mjframes.report import write_report

    start = time.perf_counter()
    folder = Path(arguments.output)
    with Console(stderr=True).status("starting") as status:
        write_report(folder, arguments.quick, arguments.mujoco4, dict(arguments.model), status.update)
    print(f"{folder / 'report.md'}: {time.perf_counter() - start:.0f} s")
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """Print what is installed and whether it works."""
    from mjframes.doctor import main as examine

    return examine()


def bench(arguments: argparse.Namespace) -> int:
    """Measure precomputation and steps."""
    from mjframes import bench as benchmark

    if arguments.growth:
        benchmark.main_of_growth(arguments.growth)
    elif arguments.file:
        benchmark.main_of_file(arguments.file, arguments.count, arguments.frames)
    else:
        benchmark.main()
    return 0


def check(arguments: argparse.Namespace) -> int:
    """Run bodies through extreme states; print and write what became of them."""
    from mjframes.check import main as try_out

    return try_out(Path(arguments.out), arguments.quick)


def largest_piece(volume: Volume) -> Volume:
    """The volume without its smaller pieces; prints how much that is."""
    largest = volume.largest_component()
    voxels, kept = (int((v.labels != 0).sum()) for v in (volume, largest))
    if kept < voxels:
        print(
            f"mjframes: {voxels - kept} of {voxels} voxels, not connected to the others, are dropped.", file=sys.stderr
        )
    return largest


@contextmanager
def printed_notices() -> Iterator[None]:
    """Prints the notices given in this block, a line each, and leaves other warnings alone."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Notice)
        try:
            yield
        finally:
            notices = [str(warning.message) for warning in caught if issubclass(warning.category, Notice)]
    for notice in notices:
        print(f"mjframes: {notice}", file=sys.stderr)


COMMANDS = {
    "build": build,
    "inspect": inspect,
    "run": run,
    "view": view,
    "bench": bench,
    "report": report,
    "check": check,
    "doctor": doctor,
}
