"""`mjframes build`: reads label image, meshes or soft body, writes soft body or scene."""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from mjframes.base.errors import MjframesError, reason
from mjframes.cli.build_arguments import given
from mjframes.cli.notices import printed_notices

if TYPE_CHECKING:
    from mjframes.body.soft_body import SoftBody
    from mjframes.frames.supports import Support
    from mjframes.volume.volume import Volume


def build(arguments: argparse.Namespace) -> int:
    """Read label image, meshes or soft body; write soft body (.npz) or scene (.xml), or one for each piece."""
    if not arguments.pieces:
        return _build(arguments)
    from mjframes.cli.inputs import numbered
    from mjframes.volume.pieces import load_pieces

    if len(arguments.volume) > 1:
        raise MjframesError(f"{arguments.volume[1]}: --pieces takes one mesh apart; give one file.")
    output, pieces = Path(arguments.output), list(load_pieces(arguments.volume[0]))
    material = numbered(arguments.material, pieces, arguments.volume[0])
    for number, name in enumerate(pieces):
        called = re.sub(r"\W+", "_", name)
        some = argparse.Namespace(**vars(arguments))
        some.piece, some.pieces, some.material = number + 1, pieces, material
        some.name = called if arguments.name == "soft" and not called.isdecimal() else f"{arguments.name}_{called}"
        if not arguments.into:
            some.output = str(output.with_stem(f"{output.stem}-{called}"))
        elif number:
            some.into = arguments.output
        _build(some)
    return 0


def _build(arguments: argparse.Namespace) -> int:
    """Build and write one body."""
    output = Path(arguments.output)
    if output.suffix.lower() not in (".npz", ".xml"):
        raise MjframesError(f"{output}: the output is a soft body (.npz) or a scene (.xml); give one of these endings.")
    if output.suffix.lower() == ".npz" and (arguments.into or arguments.fragment):
        raise MjframesError(f"{output}: --into and --fragment write MJCF; give the output the ending .xml.")
    placing = {"parent": "world", "pos": (0, 0, 0), "quat": (1, 0, 0, 0)}
    moved = [name for name, default in placing.items() if getattr(arguments, name) != default]
    if moved and not arguments.into:
        raise MjframesError(f"--{moved[0]} places the body in the scene of --into; give that too, or leave it out.")
    if any(one.kind == "near" for one in arguments.fixed) and not arguments.into:
        raise MjframesError("--fixed near:… measures from the geoms of a scene's body; give --into and --parent.")
    import mujoco
    from rich.console import Console

    from mjframes.base.files import replacing
    from mjframes.body.soft_body import is_soft_body
    from mjframes.scene.contact import Contact
    from mjframes.scene.scene_file import bounds, fragment, scene_with, standalone_scene, write_scene
    from mjframes.scene.solver import advice

    start = time.perf_counter()
    console = Console(stderr=True)
    contact = Contact(dents=False) if arguments.no_dents else arguments.contact
    with replacing(output, "the output") as partial, console.status("reading") as status:
        built = any(map(is_soft_body, arguments.volume))
        body = _loaded(arguments) if built else _built(arguments, status.update)
        status.update("writing")
        try:
            if arguments.into:
                place = (arguments.name, arguments.parent, arguments.pos, arguments.quat)
                with printed_notices():
                    spec = scene_with(body, arguments.into, *place, contact)
            elif arguments.fragment:
                spec = fragment(body, arguments.name, contact)
            else:
                spec = standalone_scene(body, body.fields.volume, arguments.name, contact)
            model = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            if isinstance(error, MjframesError):
                raise
            raise MjframesError(f"MuJoCo cannot compile the soft body ({reason(error)}).") from error
        if output.suffix.lower() == ".npz":
            body.save(str(partial))
        else:
            write_scene(spec, partial)
    print(
        f"{output}: {len(body.parent)} frames, {len(body.stiffness.points)} regions, {body.voxels} voxels, "
        f"{model.nv} degrees of freedom, {len(body.skin.vertices)} vertices, {time.perf_counter() - start:.2f} s"
    )
    lower, upper = bounds(body.fields.volume)
    size = " × ".join(f"{length * 1e3:.4g}" for length in upper - lower)
    print(f"size: {size} mm, mass: {body.control.mass.sum():.3g} kg")
    if body.error:
        print(f"error: {body.error}")
    if arguments.into and (faster := advice(model)):
        print(f"faster with {faster}")
    return 0


def _loaded(arguments: argparse.Namespace) -> SoftBody:
    """The soft body that is given.  Raise MjframesError for what does not go with it."""
    from mjframes.body.soft_body import SoftBody

    path = arguments.volume[0]
    if len(arguments.volume) > 1:
        raise MjframesError(f"{arguments.volume[1]}: there is more than one file beside a soft body; give that alone.")
    if changed := [name for name, default in arguments.building.items() if getattr(arguments, name) != default]:
        raise MjframesError(
            f"{path}: this is a soft body, built already, to which --{changed[0].replace('_', '-')} does nothing; "
            "leave that out, or build from the volume or meshes again."
        )
    if Path(arguments.output).suffix.lower() == ".npz":
        raise MjframesError(f"{path}: this is a soft body already; give the output the ending .xml, for a scene of it.")
    return SoftBody.load(path)


def _built(arguments: argparse.Namespace, progress: Callable[[str], None]) -> SoftBody:
    """The soft body made of the volume or the meshes that are given."""
    from mjframes.base.constants import METRES
    from mjframes.body.build import build as build_body
    from mjframes.cli.inputs import (
        Materials,
        of_piece,
        parse_default,
        parse_fill,
        parse_materials,
        read_materials,
        read_volume,
    )

    materials = read_materials(arguments.materials) if arguments.materials else Materials()
    own, default = parse_default(arguments.material)
    materials = Materials(
        materials.by_label | parse_materials(own),
        parse_fill(arguments.fill) if arguments.fill else materials.fill,
        default or materials.default,
    )
    name = None
    if arguments.piece is not None:
        name = arguments.pieces[arguments.piece - 1]
        materials = of_piece(materials, arguments.piece, arguments.pieces, arguments.volume[0])
    with printed_notices():
        volume = read_volume(
            arguments.volume,
            materials,
            spacing=arguments.spacing,
            voxels=arguments.voxels,
            scale=METRES[arguments.unit] if arguments.unit else arguments.scale,
            drop_unknown=arguments.drop_unknown,
            up=arguments.up,
            piece=name,
        )
    if arguments.largest:
        volume = largest_piece(volume)
    with printed_notices():
        return build_body(volume, supports=_supports(arguments, volume), progress=progress, **given(arguments))


def _supports(arguments: argparse.Namespace, volume: Volume) -> list[Support]:
    """What --fixed holds, in one piece."""
    from mjframes.cli.fixed import fixed_mask
    from mjframes.frames.supports import Fixed

    place = (arguments.into, arguments.parent, arguments.pos, arguments.quat)
    return [Fixed(fixed_mask(arguments.fixed, volume, *place))] if arguments.fixed else []


def largest_piece(volume: Volume) -> Volume:
    """Return the volume without its smaller pieces; print how much that is."""
    largest = volume.largest_component()
    voxels, kept = (int((v.labels != 0).sum()) for v in (volume, largest))
    if kept < voxels:
        print(
            f"mjframes: {voxels - kept} of {voxels} voxels, not connected to the others, are dropped.", file=sys.stderr
        )
    return largest
