"""The command line: `mjframes build`, `materials`, `inspect`, `run`, `replay`, `press`, `collect`, `view`, `doctor`.

A mistake of the user ends in one sentence on stderr and exit code 2; files appear whole or not at all.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

from mjframes.base.errors import MjframesError, out_of_memory
from mjframes.cli.arguments import command_line, joined
from mjframes.cli.notices import printed_notices


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    words = joined(sys.argv[1:] if argv is None else argv)

    def run_command() -> int:
        arguments = command_line(COMMANDS, words).parse_args(words)
        return arguments.command(arguments)

    return exit_code(run_command)


def exit_code(program: Callable[[], int]) -> int:
    """Run a program; return its exit code. Whatever stops it is one sentence on stderr."""
    _open_streams()
    try:
        with _terminable():
            status = program()
            sys.stdout.flush()
            return status
    except MjframesError as error:
        print(f"mjframes: {error}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"mjframes: {out_of_memory(error)}", file=sys.stderr)
        return 2
    except OSError as error:
        what = "the results cannot be printed" if error.filename is None else f"{error.filename}: it cannot be used"
        if error.filename is None:  # it is no file but stdout
            _discard_stdout()
        print(f"mjframes: {what} ({error.strerror or error}).", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mjframes: interrupted.", file=sys.stderr)
        return 130


def _open_streams() -> None:
    """Let what is printed go nowhere where stdout or stderr is closed; no file that is opened takes its number then."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  (as long as the process)


@contextmanager
def _terminable() -> Iterator[None]:
    """Lets SIGTERM end what runs in this block as an exception does, so that no half-written file stays."""

    def leave(number: int, frame: FrameType | None) -> NoReturn:
        raise SystemExit(128 + number)

    if threading.current_thread() is not threading.main_thread():  # only that one may set a handler
        yield
        return
    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _discard_stdout() -> None:
    """Lets what is still in stdout's buffer go nowhere: Python would complain of it once more at its end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def build(arguments: argparse.Namespace) -> int:
    """Read label image, meshes or soft body; write soft body (.npz) or scene (.xml), or one for each piece."""
    from mjframes.cli.build import build as build_files

    return build_files(arguments)


def materials(arguments: argparse.Namespace) -> int:
    """Print the library as a table, or a YAML template of the labels of an image."""
    from mjframes.cli.inputs import template
    from mjframes.volume.library import LIBRARY

    if arguments.scan:
        print(template(arguments.scan))
        return 0
    print(f"{'name':16}{'young [Pa]':>12}{'poisson':>9}{'density [kg/m³]':>17}  source")
    for name, known in LIBRARY.items():
        young = "rigid" if known.young is None else f"{known.young:.3g}"
        print(f"{name:16}{young:>12}{known.poisson:>9g}{known.density:>17g}  {known.source}")
    return 0


def inspect(arguments: argparse.Namespace) -> int:
    """Read a soft body; write pictures of what was precomputed."""
    from rich.console import Console

    from mjframes.app.inspect import draw_pictures
    from mjframes.body.soft_body import SoftBody

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
    from mjframes.app.log.options import Log
    from mjframes.app.recording import summary
    from mjframes.app.run import record
    from mjframes.scene.load import load_scene
    from mjframes.scene.solver import advice
    from mjframes.scene.view import soft_names

    if not arguments.log and (arguments.log_rate or arguments.log_topics):
        raise MjframesError("--log-rate and --log-topics are of a log; give --log FILE.mcap as well.")
    model, spec = load_scene(arguments.scene)
    with printed_notices():
        recording = record(
            model,
            arguments.duration,
            video=arguments.video,
            log=Log(arguments.log, arguments.log_rate, arguments.log_topics) if arguments.log else None,
            plot=arguments.plot,
            camera=arguments.camera,
            fps=arguments.fps,
            size=arguments.size,
            scene=spec,
            ctrl=arguments.ctrl,
            keyframe=arguments.keyframe,
            progress=True,
        )
    print(summary(recording))
    if (faster := advice(model)) and soft_names(model):
        print(f"faster with   {faster}")
    return 0


def replay(arguments: argparse.Namespace) -> int:
    """Make film, plot and states of a log, without simulating again."""
    from mjframes.app.log.read import read_log
    from mjframes.app.replay import film_of, plot_of, state_at

    log = read_log(arguments.log, arguments.world)
    if not (arguments.video or arguments.plot or arguments.state is not None):
        raise MjframesError("nothing is asked for; give --video, --plot or --state.")
    if not log.whole:
        end = log.states()[-1]["time"]
        print(f"mjframes: {arguments.log}: the log was cut off at {end:g} s; what is there is used.", file=sys.stderr)
    if arguments.plot:
        plot_of(log, arguments.plot)
    if arguments.video:
        film_of(log, arguments.video, arguments.camera, arguments.fps, arguments.size)
    if arguments.state is not None:
        print(json.dumps(state_at(log, arguments.state)))
    return 0


def press(arguments: argparse.Namespace) -> int:
    """Press an indenter into a soft body; write force over depth as plot and table."""
    from mjframes.app.plot import figure_file
    from mjframes.app.press import Indenter, plot_press, summary, write_table
    from mjframes.app.press import press as press_body

    scene = Path(arguments.scene)
    plot = Path(arguments.plot or scene.with_name(f"{scene.stem}-press.png"))
    table = Path(arguments.table or scene.with_name(f"{scene.stem}-press.csv"))
    kind, size = arguments.indenter
    path = {"at": arguments.at, "direction": arguments.direction, "speed": arguments.speed}
    with figure_file(plot, (7, 5)) as figure:  # before the press, which takes a while
        pressed = press_body(scene, Indenter(kind, size), arguments.depth, body=arguments.body, **path)
        write_table(pressed, table)
        plot_press(pressed, figure, f"{scene.stem}: {kind}:{1e3 * size:g}mm")
    for note in pressed.notes:
        print(f"mjframes: {note}", file=sys.stderr)
    print(f"{plot}, {table}: {summary(pressed)}")
    return 0


def collect(arguments: argparse.Namespace) -> int:
    """Step many worlds of a scene; write shards and a table."""
    from mjframes.app.collect.options import CollectOptions
    from mjframes.app.collect.run import collect as collect_worlds
    from mjframes.cli.options import spoken

    start = time.perf_counter()
    with printed_notices():
        given = {some.name: getattr(arguments, some.name) for some, _ in spoken(CollectOptions)}
        found = collect_worlds(arguments.scene, arguments.out, **given, progress=True)
    early = f", {found.ended} of them end early, see worlds.csv" if found.ended else ""
    seconds = time.perf_counter() - start
    print(f"{found.folder}: {found.worlds} worlds in {len(found.shards)} shards{early}, {seconds:.1f} s")
    return 0


def view(arguments: argparse.Namespace) -> int:
    """Open MuJoCo's viewer for one scene after the other, or serve a page of all until Ctrl-C."""
    from mjframes.app.video import has_display
    from mjframes.scene.load import load_scene

    if not arguments.web and (arguments.host is not None or arguments.port is not None):
        raise MjframesError("--host and --port are of a page; give --web as well.")
    models = {scene: load_scene(scene)[0] for scene in arguments.scenes}
    if arguments.web:
        from mjframes.app.view.page import HOST, PORT, page

        port = PORT if arguments.port is None else arguments.port
        with page(models, arguments.host or HOST, port) as shown, suppress(KeyboardInterrupt):
            where = f"http://{arguments.host or HOST}:{shown.port}"
            print(f"{', '.join(models)}: open {where} and end with Ctrl-C", flush=True)
            shown.run()
        return 0
    if not has_display():
        raise MjframesError("there is no display to open a window on; use mjframes view --web SCENE instead.")
    import mujoco.viewer

    for model in models.values():
        mujoco.viewer.launch(model)
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """Print what is installed and whether it works."""
    from mjframes.app.doctor import main as examine

    return examine()


COMMANDS = {
    "build": build,
    "materials": materials,
    "inspect": inspect,
    "run": run,
    "replay": replay,
    "press": press,
    "collect": collect,
    "view": view,
    "doctor": doctor,
}
