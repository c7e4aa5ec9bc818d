"""The page of some scenes: a server, and the loop beside it that steps and shows one of them."""

from __future__ import annotations

import io
import os
import queue
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from mjframes.app.view.cameras import aim
from mjframes.app.view.grip import Grip, grip_body, grip_skin
from mjframes.app.view.guard import guarded, keep_to_values, point_in
from mjframes.app.view.simulation import Simulation
from mjframes.base.errors import MjframesError, reason
from mjframes.base.packages import optional
from mjframes.scene.load import mujoco_warnings

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

    from mjframes.app.view.stage import Node

HOST, PORT = "127.0.0.1", 8080
FRAME = 1 / 30  # [s] of wall time between two pictures
STEPPING = 0.8  # [-] of it for steps at most: what is left is for drawing and for what the page asks
FAR = 1e3  # [-] of the scene's extent: nothing is drawn farther away by the mouse
CURVES = 8  # pictures between two updates of numbers and curves


class Page:
    """Scenes on a page: one of them is shown and runs, from when a browser has the page.

    server: of viser.  scenes: the simulations by name.  simulation: the one that is shown.
    stage, controls: what the page shows of it.
    """

    def __init__(self, server: ViserServer, scenes: Mapping[str, Simulation]) -> None:
        self.server, self.scenes = server, scenes
        self._commands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._visited = False
        for simulation in scenes.values():
            simulation.paused = True
        self.show(next(iter(scenes)))

        async def come(client: ClientHandle) -> None:
            self._commands.put(self._visit)

        server.on_client_connect(come)

    def show(self, name: str) -> None:
        """Show the scene of that name, as it was left; it runs if somebody sees it."""
        from mjframes.app.view.controls import Controls
        from mjframes.app.view.stage import Stage

        server = self.server
        server.scene.reset()
        server.gui.reset()
        self.simulation = simulation = self.scenes[name]
        simulation.paused = not self._visited
        model = simulation.model
        if len(self.scenes) > 1:
            self._add_chooser(name)
        self.stage = Stage(server, model, simulation.data)
        self.controls = Controls(server, simulation, self._commands)
        view = self.controls.view()
        for camera in (server.initial_camera, *(client.camera for client in server.get_clients().values())):
            aim(camera, view)
            camera.near = 0.01 * model.stat.extent
        for piece in self.stage.skins:
            self._let_drag(piece.node, lambda at, skin=piece.skin: self._grip_skin(skin, at))
        for node, body in self.stage.rigid:
            self._let_drag(node, lambda at, body=body: grip_body(model, simulation.data, body, at))

    def _visit(self) -> None:
        """Start the scene for the first browser that comes."""
        if not self._visited:
            self._visited, self.simulation.paused = True, False

    def _add_chooser(self, name: str) -> None:
        async def later(event: Any) -> None:
            if event.client is not None:
                chosen = event.target.value
                self._commands.put(lambda: self.show(chosen))

        self.server.gui.add_dropdown("scene", tuple(self.scenes), initial_value=name).on_update(later)

    @property
    def port(self) -> int:
        """Where it is served."""
        return self.server.get_port()

    def run(self, stop: threading.Event | None = None) -> None:
        """Step and show in real time, until there is a stop."""
        frame = 0
        while stop is None or not stop.is_set():
            begin = time.perf_counter()
            while not self._commands.empty():
                self._do(self._commands.get())
            self.simulation.advance(STEPPING * FRAME)
            self.stage.draw(self.simulation.data)
            if frame % CURVES == 0:
                self.controls.show()
            frame += 1
            time.sleep(max(0.0, FRAME - (time.perf_counter() - begin)))

    def _do(self, command: Callable[[], None]) -> None:
        """Do what the page asked for; whatever is wrong with that, the page goes on."""
        try:
            command()
        except Exception as error:
            print(f"mjframes: what the page asked for cannot be done ({reason(error)}).", file=sys.stderr)

    def _grip_skin(self, skin: int, at: np.ndarray) -> Grip:
        simulation = self.simulation
        return grip_skin(simulation.model, simulation.data, skin, self.stage.vertices[skin], at)

    def _let_drag(self, node: Node, grip: Callable[[np.ndarray], Grip]) -> None:
        """Let the mouse hold a node by a grip of the point that it points at."""
        simulation = self.simulation
        far = FAR * simulation.model.stat.extent

        async def later(event: Any) -> None:  # a coroutine: those are called in order
            start, end = point_in(far, event.start_position), point_in(far, event.end_position)
            if event.phase == "end":
                self._commands.put(simulation.release)
            elif start is not None and end is not None:
                phase = event.phase
                self._commands.put(lambda: drag(phase, start, end))

        def drag(phase: str, start: np.ndarray, end: np.ndarray) -> None:
            if phase == "start":
                simulation.hold(grip(start))
            if simulation.held is not None:
                simulation.target = end

        node.on_drag("left")(later)


@contextmanager
def page(scenes: Mapping[str, mujoco.MjModel], host: str = HOST, port: int = PORT) -> Iterator[Page]:
    """A page of one or more scenes at their initial states, served in this block.

    scenes: models by the names that the page's chooser lists; the first is shown first.
    host, port: where; port 0 is any that is free.
    Raises MjframesError where viser is missing, for an address that is taken or cannot be, and for a scene that the
    plugin refuses.
    """
    viser = optional("viser", "the page", "view")
    try:
        socket.create_server((host, port)).close()
    except (OSError, OverflowError) as error:
        number = getattr(error, "errno", None) or 0  # negative where a name is not known
        refused = os.strerror(number) if number > 0 else getattr(error, "strerror", None) or error
        raise MjframesError(
            f"nothing can be served at {host}:{port} ({refused}); give another --port, or 0 for any that is free."
        ) from error
    with mujoco_warnings() as warnings:
        simulations = {name: Simulation(model, warnings) for name, model in scenes.items()}
        # viser says where it is, and that it ends, whatever it is asked
        with redirect_stdout(io.StringIO()), guarded(host):
            server = viser.ViserServer(host, port, verbose=False)
        keep_to_values(server)
        try:
            yield Page(server, simulations)
        finally:
            with redirect_stdout(io.StringIO()):
                server.stop()
