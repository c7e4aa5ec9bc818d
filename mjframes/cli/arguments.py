"""What may stand on the command line, and how each value is read."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

from mjframes.app.log.options import TOPICS
from mjframes.base import texts
from mjframes.base.errors import MjframesError
from mjframes.cli.lengths import direction, indenter
from mjframes.cli.options import add_options

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


def command_line(functions: Mapping[str, Callable[[argparse.Namespace], int]], words: Sequence[str]) -> Parser:
    """Return the parser; its result has as `command` one of the functions, by the name of the command.

    words: that it will parse; a command that is not among them is listed, without its arguments.
    """
    parser = Parser(prog="mjframes", description="Soft bodies of several materials in MuJoCo, made of a few frames.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (help_, add) in COMMANDS.items():
        command = commands.add_parser(name, help=help_)
        command.set_defaults(command=functions[name])
        if name in words:
            add(command)
    return parser


def _add_build(command: argparse.ArgumentParser) -> None:
    from mjframes.cli.build_arguments import add_build  # with what builds; the other commands start without

    add_build(command)


def _add_materials(command: argparse.ArgumentParser) -> None:
    command.add_argument("scan", nargs="?", metavar="SCAN", help="label image whose labels a YAML template names")


def _add_inspect(command: argparse.ArgumentParser) -> None:
    command.add_argument("asset", metavar="BODY", help="soft body (.npz) that build wrote")
    command.add_argument(
        "-o", "--output", metavar="FOLDER", help="of the pictures (default: beside the body, with its name)"
    )


def _add_run(command: argparse.ArgumentParser) -> None:
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
        type=texts.factor,
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


def _add_replay(command: argparse.ArgumentParser) -> None:
    command.add_argument("log", metavar="LOG", help="log that run wrote (.mcap), or what a killed run left of it")
    command.add_argument("--video", metavar="FILE", help="film to write: .mp4, .mkv, .mov")
    command.add_argument("--plot", metavar="FILE", help="figure to write: .png, .pdf, .svg")
    command.add_argument("--world", type=texts.seed, metavar="N", help="which, of a shard that collect wrote")
    command.add_argument(
        "--state", type=float, metavar="T", help="print the logged state nearest to this time [s], as JSON"
    )
    _add_film(command)


def _add_press(command: argparse.ArgumentParser) -> None:
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
        "--depth", type=texts.length, required=True, metavar="LENGTH", help="from the first force on: 5mm, or in metres"
    )
    command.add_argument("--body", metavar="NAME", help="the soft body, where the scene has several")
    command.add_argument(
        "--at", type=texts.place, metavar="X,Y,Z", help="a point on its path [m] (default: the middle)"
    )
    command.add_argument(
        "--direction", type=direction, default=(0.0, 0.0, -1.0), metavar="AXIS|X,Y,Z", help="of its path (default -z)"
    )
    command.add_argument("--speed", type=texts.factor, metavar="M/S", help="(default: the depth in one second)")
    command.add_argument("--plot", metavar="FILE", help="figure to write (default: SCENE-press.png)")
    command.add_argument("--table", metavar="FILE", help="depth_m,force_N,hertz_N to write (default: SCENE-press.csv)")


def _add_collect(command: argparse.ArgumentParser) -> None:
    from mjframes.app.collect.options import CollectOptions

    command.add_argument("scene", metavar="SCENE", help="MJCF file (.xml)")
    command.add_argument(
        "--out", required=True, metavar="FOLDER", help="new, empty, or of the same collection, which then goes on"
    )
    add_options(command, CollectOptions)


def _add_view(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "scenes",
        nargs="+",
        metavar="SCENE",
        help="MJCF file (.xml); the viewer opens several one after the other, the page has a list to choose from",
    )
    command.add_argument("--web", action="store_true", help="serve a page, where there is no display as well")
    command.add_argument("--host", metavar="NAME", help="of the page: 0.0.0.0 for other machines (default 127.0.0.1)")
    command.add_argument("--port", type=_port, metavar="N", help="of the page, 0 for any that is free (default 8080)")


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


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to 65535")
    return int(text)


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT in pixels")
    return int(width), int(height)


COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "build": ("make a soft body or a scene from a label image or meshes", _add_build),
    "materials": ("list the library of materials, or write a template for an image", _add_materials),
    "inspect": ("draw what build computed: stiffness, distance, weights, regions", _add_inspect),
    "run": ("step a scene; write a video, a log, a plot", _add_run),
    "replay": ("make film, plot and states of a log, without simulating again", _add_replay),
    "press": ("press a ball, cylinder or punch into a soft body; force over depth", _add_press),
    "collect": ("step many worlds of a scene, each with its own materials and pushes", _add_collect),
    "view": ("open scenes in MuJoCo's viewer, or on a page for a browser", _add_view),
    "doctor": ("tell what is installed and whether it works", lambda command: None),
}
