"""What `mjframes build` takes: the options of `BuildOptions` as they are declared, and what the volume is made of."""

from __future__ import annotations

import argparse
from typing import Any

from mjframes.base import texts
from mjframes.base.constants import UP
from mjframes.base.errors import MjframesError
from mjframes.body.options import BuildOptions
from mjframes.cli.fixed import FORMS, chosen
from mjframes.cli.options import add_options, spoken
from mjframes.volume.images import IMAGE_TYPES
from mjframes.volume.meshes import MESH_TYPES


def add_build(command: argparse.ArgumentParser) -> None:
    """Add the arguments; `building` gets the defaults of those that do nothing to a body that is built already."""
    command.add_argument(
        "volume",
        nargs="+",
        metavar="FILE",
        help=f"a label image ({' '.join(IMAGE_TYPES)}; 0 is outside) "
        f"or closed surfaces ({' '.join(MESH_TYPES)}; later ones win), labelled 1, 2, … in their order; "
        "or a soft body (.npz) that is built already",
    )
    command.add_argument("-o", "--output", required=True, metavar="FILE", help="soft body (.npz) or scene (.xml)")
    _add_scene(command.add_argument_group("the scene"))
    _add_volume(command.add_argument_group("the volume"))
    _add_body(command.add_argument_group("the body"))
    building = argparse.ArgumentParser()
    _add_volume(building)
    _add_body(building)
    command.set_defaults(piece=None, building=vars(building.parse_args([])))


def given(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `build` that the command line has. Raise MjframesError for those of another choice."""
    found = {}
    for some, said in spoken(BuildOptions):
        name = some.name
        found[name] = getattr(arguments, name)
        for choice, kind in said.kinds.items():
            own = {one.name: getattr(arguments, one.name) for one, _ in spoken(kind)}
            own = {key: value for key, value in own.items() if value is not None}
            if own and found[name] != choice:
                raise MjframesError(
                    f"--{next(iter(own))} is given, but only --{name} {choice} has any; leave it out, or choose that."
                )
            if own:
                found[name] = kind(**own)
    return found


def _add_body(command: argparse._ActionsContainer) -> None:
    """Add what is glued, and the options of `build`."""
    command.add_argument(
        "--fixed",
        type=chosen,
        action="append",
        default=[],
        metavar="WHERE",
        help=f"what is glued to --parent: {FORMS}, within that distance of its geoms; repeatable",
    )
    add_options(command, BuildOptions)


def _add_scene(command: argparse._ActionsContainer) -> None:
    """Add where the body goes."""
    places = command.add_mutually_exclusive_group()
    places.add_argument(
        "--into", metavar="SCENE", help="put it into a copy of this scene (.xml), or name that as output"
    )
    places.add_argument(
        "--fragment", action="store_true", help="the body alone, for MJCF's <attach>: no floor, light or camera"
    )
    command.add_argument("--name", default="soft", help="of the body in the scene (default %(default)s)")
    command.add_argument("--parent", default="world", metavar="BODY", help="of --into's scene (default %(default)s)")
    command.add_argument(
        "--pos",
        type=texts.place,
        default=(0.0, 0.0, 0.0),
        metavar="X,Y,Z",
        help="in that body [m] (default 0,0,0)",
    )
    command.add_argument(
        "--quat",
        type=texts.orientation,
        default=(1.0, 0.0, 0.0, 0.0),
        metavar="W,X,Y,Z",
        help="in that body (default 1,0,0,0)",
    )
    touching = command.add_mutually_exclusive_group()
    touching.add_argument("--no-contact", dest="contact", action="store_false", help="a scene without contact")
    touching.add_argument(
        "--no-dents",
        action="store_true",
        help="contacts as stiff as the frames: faster, too stiff where something presses",
    )
    command.add_argument(
        "--pieces",
        action="store_true",
        help="a body of each object or unconnected surface of a mesh: files parts-NAME.xml, or all --into a scene",
    )


def _add_volume(command: argparse._ActionsContainer) -> None:
    """Add how files become voxels, and of which materials."""
    command.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="LABEL=NAME:KEY=VALUE,…",
        help="one for each label, unless the image carries them: "
        "1=flesh:young=3e4,poisson=0.45,density=1050 or 2=bone:rigid,density=1900; [Pa], [kg/m³]; "
        "1=silicone-00-30 of mjframes materials; constants of a --law, as c10=2e3; "
        "default=… for all other labels; with --pieces LABEL is the name or "
        "the number of a piece",
    )
    command.add_argument("--materials", metavar="FILE.yaml", help="the same for several labels, in a file")
    command.add_argument(
        "--fill", metavar="NAME:KEY=VALUE,…", help="material of the rest of the convex hull: flesh around bones"
    )
    command.add_argument(
        "--spacing", type=texts.spacing, metavar="METRES", help="edge of a voxel, or three: 0.001,0.001,0.002"
    )
    command.add_argument(
        "--voxels", type=texts.count, metavar="N", help="about how many voxels to have inside (meshes: 20000)"
    )
    units = command.add_mutually_exclusive_group()
    units.add_argument(
        "--unit",
        choices=("m", "dm", "cm", "mm", "um", "in", "ft"),
        help="of the meshes (default: that of a .3mf, or else m)",
    )
    units.add_argument("--scale", type=texts.factor, metavar="FACTOR", help="metres in a unit of the meshes")
    command.add_argument("--up", choices=UP, default="z", help="axis of the file that points up (default %(default)s)")
    command.add_argument("--drop-unknown", action="store_true", help="an image's labels without a material are outside")
    command.add_argument("--largest", action="store_true", help="drop all pieces but the largest")
