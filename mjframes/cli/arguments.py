"""What may stand on the command line, and how each value is read."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

from mjframes.app.collect.plan import CONTROLS
from mjframes.app.log.options import TOPICS
from mjframes.base.choices import (
    COROTATIONAL,
    FRAME_TYPES,
    IMPLICIT,
    LAWS,
    MASSES,
    METHODS,
    MODES,
    VORONOI,
    WEIGHTS,
    WHOLE_BODY,
)
from mjframes.base.constants import UP
from mjframes.base.errors import MjframesError
from mjframes.cli.fixed import FORMS, chosen
from mjframes.cli.lengths import direction, indenter, length
from mjframes.volume.meshes import MESH_TYPES

BUILDING = (  # what says how a body is built, and so nothing to one that is
    "frames", "error", "method", "samples", "material", "materials", "fill", "spacing", "voxels", "unit", "scale", "up",
    "drop_unknown", "largest", "frame_type", "law", "mass", "mode", "damping", "weights", "subdivisions", "seed",
    "fixed",
)  # fmt: skip


NEGATIVE = re.compile(r"-([xyz](:.*)?|[0-9.].*)")  # a value that begins as an option does


def joined(words: Sequence[str]) -> list[str]:
    """Return the command line with values like -z or -1,0,0 joined to the option before them: argparse needs that."""
    found: list[str] = []
    for word in words:
        if NEGATIVE.fullmatch(word) and found and re.fullmatch(r"--[a-z-]+", found[-1]):
            found[-1] += f"={word}"
        else:
            found.append(word)
    return found


class Parser(argparse.ArgumentParser):
    """argparse that reports a mistake as everything else here does."""

    def error(self, message: str) -> NoReturn:
        raise MjframesError(f"{message}; see {self.prog} --help.")


def command_line(functions: Mapping[str, Callable[[argparse.Namespace], int]]) -> Parser:
    """Return the parser; its result has as `command` one of the functions, by the name of the command."""
    parser = Parser(prog="mjframes", description="Soft bodies of several materials in MuJoCo, made of a few frames.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser("build", help="make a soft body or a scene from a label image or meshes")
    command.set_defaults(command=functions["build"])
    command.add_argument(
        "volume",
        nargs="+",
        metavar="FILE",
        help="a label image (.npz .npy .nrrd .nii .nii.gz .mha .mhd .mgz; 0 is outside) "
        f"or closed surfaces ({' '.join(MESH_TYPES)}; later ones win), labelled 1, 2, … in their order; "
        "or a soft body (.npz) that is built already",
    )
    command.add_argument("-o", "--output", required=True, metavar="FILE", help="soft body (.npz) or scene (.xml)")
    places = command.add_mutually_exclusive_group()
    places.add_argument(
        "--into", metavar="SCENE", help="put it into a copy of this scene (.xml), or name that as output"
    )
    places.add_argument(
        "--fragment", action="store_true", help="the body alone, for MJCF's <attach>: no floor, light or camera"
    )
    command.add_argument(
        "--pieces",
        action="store_true",
        help="a body of each object or unconnected surface of a mesh: files parts-NAME.xml, or all --into a scene",
    )
    command.add_argument("--name", default="soft", help="of the body in the scene (default %(default)s)")
    command.add_argument("--parent", default="world", metavar="BODY", help="of --into's scene (default %(default)s)")
    command.add_argument(
        "--fixed",
        type=chosen,
        action="append",
        default=[],
        metavar="WHERE",
        help=f"what is glued to that body: {FORMS}, within that distance of its geoms; repeatable",
    )
    command.add_argument(
        "--pos",
        type=_place,
        default=(0.0, 0.0, 0.0),
        metavar="X,Y,Z",
        help="in that body [m] (default 0,0,0)",
    )
    command.add_argument(
        "--quat",
        type=_orientation,
        default=(1.0, 0.0, 0.0, 0.0),
        metavar="W,X,Y,Z",
        help="in that body (default 1,0,0,0)",
    )
    wanted = command.add_mutually_exclusive_group()
    wanted.add_argument(
        "--frames",
        type=count,
        metavar="N",
        help="number of frames (default: the fewest of up to 20 that keep an error of 15 %%)",
    )
    wanted.add_argument(
        "--error", type=_share, metavar="E", help="as many frames as it takes for this error, 0.05 for 5 %%"
    )
    command.add_argument(
        "--method", choices=METHODS, default=WHOLE_BODY,
        help="stiffness of the whole body, or of the paper's integration samples (default %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--samples", type=count, metavar="N", help="number of the paper's integration samples (default 10)"
    )
    command.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="LABEL=NAME:KEY=VALUE,…",
        help="one for each label, unless the image carries them: "
        "1=flesh:young=3e4,poisson=0.45,density=1050 or 2=bone:rigid,density=1900; [Pa], [kg/m³]; "
        "1=silicone-00-30 of mjframes materials; default=… for all other labels; with --pieces LABEL is the name or "
        "the number of a piece",
    )
    command.add_argument("--materials", metavar="FILE.yaml", help="the same for several labels, in a file")
    command.add_argument(
        "--fill", metavar="NAME:KEY=VALUE,…", help="material of the rest of the convex hull: flesh around bones"
    )
    command.add_argument(
        "--spacing", type=_spacing, metavar="METRES", help="edge of a voxel, or three: 0.001,0.001,0.002"
    )
    command.add_argument(
        "--voxels", type=count, metavar="N", help="about how many voxels to have inside (meshes: 20000)"
    )
    units = command.add_mutually_exclusive_group()
    units.add_argument("--unit", choices=("m", "dm", "cm", "mm", "um", "in", "ft"), help="of the meshes (default m)")
    units.add_argument("--scale", type=_factor, metavar="FACTOR", help="metres in a unit of the meshes")
    command.add_argument("--up", choices=UP, default="z", help="axis of the file that points up (default %(default)s)")
    command.add_argument("--drop-unknown", action="store_true", help="an image's labels without a material are outside")
    command.add_argument("--largest", action="store_true", help="drop all pieces but the largest")
    command.add_argument(
        "--frame-type", choices=FRAME_TYPES, default=FRAME_TYPES[0],
        help="of all frames (default %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--law", choices=(COROTATIONAL, *LAWS), default=COROTATIONAL, help="of elasticity (default %(default)s)",
    )  # fmt: skip
    command.add_argument("--mass", choices=MASSES, help="mass matrix (default: what suits the frame types)")
    command.add_argument(
        "--mode", choices=MODES, default=IMPLICIT,
        help="explicit needs small steps and allows RK4 (default %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--damping",
        type=_rates,
        default=(0.0, 0.0),
        metavar="ALPHA,BETA",
        help="Rayleigh's, [1/s] and [s] (default 0,0)",
    )
    command.add_argument("--weights", choices=WEIGHTS, default=VORONOI, help="(default %(default)s)")
    command.add_argument("--subdivisions", type=count, metavar="N", help="of the Voronoi kernels (default 1)")
    command.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="of the frame placement (default %(default)s)"
    )
    touching = command.add_mutually_exclusive_group()
    touching.add_argument("--no-contact", dest="contact", action="store_false", help="a scene without contact")
    touching.add_argument(
        "--dents", action="store_true", help="let the flesh below a contact give way as finite elements say"
    )
    command.set_defaults(piece=None)
    command.set_defaults(building={name: command.get_default(name) for name in BUILDING})

    command = commands.add_parser("materials", help="list the library of materials, or write a template for an image")
    command.set_defaults(command=functions["materials"])
    command.add_argument("scan", nargs="?", metavar="SCAN", help="label image whose labels a YAML template names")

    command = commands.add_parser("inspect", help="draw what build computed: stiffness, distance, weights, regions")
    command.set_defaults(command=functions["inspect"])
    command.add_argument("asset", metavar="BODY", help="soft body (.npz) that build wrote")
    command.add_argument(
        "-o", "--output", metavar="FOLDER", help="of the pictures (default: beside the body, with its name)"
    )

    command = commands.add_parser("run", help="step a scene; write a video, a log, a plot")
    command.set_defaults(command=functions["run"])
    command.add_argument("scene", metavar="SCENE", help="MJCF file (.xml)")
    command.add_argument("--duration", type=float, default=3.0, metavar="SECONDS", help="(default %(default)s)")
    command.add_argument(
        "--ctrl",
        type=_controls,
        metavar="NAME=VALUE,…|FILE",
        help="constant controls by their actuators, or a file of controls over time: "
        ".csv with the header time,NAME,… or .npy (t, 1 + nu); each row holds until the next",
    )
    command.add_argument("--keyframe", metavar="NAME|N", help="of the scene to start from (default: its initial state)")
    command.add_argument("--video", metavar="FILE", help="film to write: .mp4, .mkv, .mov")
    command.add_argument("--log", metavar="FILE", help="log to write: .mcap, for Foxglove")
    command.add_argument(
        "--log-rate",
        type=_factor,
        metavar="HZ",
        help="entries of the log a simulated second (default: numbers as in a plot, states and scene as in a film)",
    )
    command.add_argument(
        "--log-topics",
        type=_topics,
        metavar="NAME,…",
        help=f"what to log (default {','.join(TOPICS[:-1])}, and {TOPICS[-1]} with --video)",
    )
    command.add_argument("--plot", metavar="FILE", help="figure to write: .png, .pdf, .svg")
    _add_film(command)

    command = commands.add_parser("replay", help="make film, plot and states of a log, without simulating again")
    command.set_defaults(command=functions["replay"])
    command.add_argument("log", metavar="LOG", help="log that run wrote (.mcap), or what a killed run left of it")
    command.add_argument("--video", metavar="FILE", help="film to write: .mp4, .mkv, .mov")
    command.add_argument("--plot", metavar="FILE", help="figure to write: .png, .pdf, .svg")
    command.add_argument("--world", type=seed, metavar="N", help="which, of a shard that collect wrote")
    command.add_argument(
        "--state", type=float, metavar="T", help="print the logged state nearest to this time [s], as JSON"
    )
    _add_film(command)

    command = commands.add_parser("press", help="press a ball, cylinder or punch into a soft body; force over depth")
    command.set_defaults(command=functions["press"])
    command.add_argument("scene", metavar="SCENE", help="MJCF file (.xml)")
    command.add_argument(
        "--with",
        dest="indenter",
        type=indenter,
        required=True,
        metavar="KIND:SIZE",
        help="ball:10mm or cylinder:10mm (radius, the cylinder's flat end first), punch:10mm (width of a flat square)",
    )
    command.add_argument(
        "--depth", type=length, required=True, metavar="LENGTH", help="from the first force on: 5mm, or in metres"
    )
    command.add_argument("--body", metavar="NAME", help="the soft body, where the scene has several")
    command.add_argument("--at", type=_place, metavar="X,Y,Z", help="a point on its path [m] (default: the middle)")
    command.add_argument(
        "--direction", type=direction, default=(0.0, 0.0, -1.0), metavar="AXIS|X,Y,Z", help="of its path (default -z)"
    )
    command.add_argument("--speed", type=_factor, metavar="M/S", help="(default: the depth in one second)")
    command.add_argument("--plot", metavar="FILE", help="figure to write (default: SCENE-press.png)")
    command.add_argument("--table", metavar="FILE", help="depth_m,force_N,hertz_N to write (default: SCENE-press.csv)")

    command = commands.add_parser("collect", help="step many worlds of a scene, each with its own materials and pushes")
    command.set_defaults(command=functions["collect"])
    command.add_argument("scene", metavar="SCENE", help="MJCF file (.xml)")
    command.add_argument("--worlds", type=count, required=True, metavar="N", help="how many")
    command.add_argument("--seconds", type=_factor, default=3.0, metavar="S", help="of each (default %(default)s)")
    command.add_argument(
        "--out", required=True, metavar="FOLDER", help="new, empty, or of the same collection, which then goes on"
    )
    command.add_argument(
        "--vary",
        type=_bounded,
        action="append",
        default=[],
        metavar="BODY.WHAT=LOW:HIGH",
        help="what each world draws: a material, stiffness, alpha, beta [factors]; x, y, z [m], roll, pitch, yaw "
        "[degrees] of the start; steak.flesh=0.5:2",
    )
    command.add_argument(
        "--push", type=_bounded, action="append", default=[], metavar="BODY=LOW:HIGH",
        help="a force [N] of a tenth of a second, its direction, place and time drawn: steak=0:5",
    )  # fmt: skip
    command.add_argument(
        "--control", choices=CONTROLS, default="none", help="of the actuators, in their ranges (default %(default)s)"
    )
    command.add_argument(
        "--rate", type=_factor, default=30.0, metavar="HZ", help="entries a simulated second (default %(default)s)"
    )
    command.add_argument("--seed", type=seed, default=0, metavar="N", help="of all draws (default %(default)s)")
    command.add_argument("--shard", type=count, default=128, metavar="N", help="worlds in a file (default %(default)s)")
    command.add_argument(
        "--threads", type=count, metavar="N", help="(default: one a processor, on a cluster one a shard)"
    )
    command.add_argument(
        "--ray", metavar="ADDRESS", help="of a Ray cluster that computes the shards; local for one of this machine"
    )

    command = commands.add_parser("view", help="open scenes in MuJoCo's viewer, or on a page for a browser")
    command.set_defaults(command=functions["view"])
    command.add_argument(
        "scenes",
        nargs="+",
        metavar="SCENE",
        help="MJCF file (.xml); the viewer opens several one after the other, the page has a list to choose from",
    )
    command.add_argument("--web", action="store_true", help="serve a page, where there is no display as well")
    command.add_argument("--host", metavar="NAME", help="of the page: 0.0.0.0 for other machines (default 127.0.0.1)")
    command.add_argument("--port", type=_port, metavar="N", help="of the page, 0 for any that is free (default 8080)")

    command = commands.add_parser("doctor", help="tell what is installed and whether it works")
    command.set_defaults(command=functions["doctor"])
    return parser


def _add_film(command: argparse.ArgumentParser) -> None:
    command.add_argument("--camera", metavar="NAME", help="camera of the film (default: the scene's first)")
    command.add_argument("--fps", type=float, default=30.0, metavar="N", help="frames a second (default %(default)s)")
    command.add_argument(
        "--size", type=_size, default=(1280, 720), metavar="WxH", help="of the film (default 1280x720)"
    )


def _topics(text: str) -> tuple[str, ...]:
    topics = tuple(text.split(","))
    if unknown := [topic for topic in topics if topic not in TOPICS]:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r} is none of {', '.join(TOPICS)}")
    return topics


def _controls(text: str) -> str | dict[str, float]:
    if "=" not in text:
        return text
    found: dict[str, float] = {}
    for pair in text.split(","):
        name, _, value = pair.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not name or not math.isfinite(number) or name in found:
            raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE,… with each name once, and no file either")
        found[name] = number
    return found


def _bounded(text: str) -> tuple[str, tuple[float, float]]:
    name, _, bounds = text.partition("=")
    try:
        low, high = (float(part) for part in bounds.split(":"))
    except ValueError:
        low = high = math.nan
    if not (name and math.isfinite(low) and math.isfinite(high)):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=LOW:HIGH with two numbers")
    return name, (low, high)


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to 65535")
    return int(text)


def count(text: str) -> int:
    """Read a whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def seed(text: str) -> int:
    """Read a whole number from 0 on."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def _place(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise argparse.ArgumentTypeError(f"{text!r} is not three coordinates in metres with commas between")
    return x, y, z


def _orientation(text: str) -> tuple[float, float, float, float]:
    try:
        w, x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        w = x = y = z = math.nan
    if not (all(map(math.isfinite, (w, x, y, z))) and any((w, x, y, z))):
        raise argparse.ArgumentTypeError(f"{text!r} is not a quaternion, four numbers, not all 0, with commas between")
    return w, x, y, z


def _spacing(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in (1, 3) or not all(math.isfinite(value) and value > 0 for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not one length in metres or three with commas between")
    return values * (3 // len(values))


def _rates(text: str) -> tuple[float, float]:
    try:
        alpha, beta = (float(part) for part in text.split(","))
    except ValueError:
        alpha = beta = math.nan
    if not (math.isfinite(alpha) and math.isfinite(beta) and min(alpha, beta) >= 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not two rates ≥ 0 with a comma between")
    return alpha, beta


def _factor(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number between 0 and 1")
    return value


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT in pixels")
    return int(width), int(height)
