"""What stands beside the scene: time, cameras, materials, actuators, curves."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from viser import GuiSliderHandle, GuiUplotHandle, ViserServer

from mjframes.app.control_table import control_names
from mjframes.app.taxel_picture import TaxelPicture
from mjframes.app.view.cameras import View, aim, views
from mjframes.app.view.simulation import Simulation
from mjframes.scene import scaling
from mjframes.scene.taxels import taxel_maps

Commands = queue.SimpleQueue[Callable[[], None]]
SOFTEST, STIFFEST = 0.1, 10.0  # [-] range of a factor
START = "start"  # of the scene, beside its keyframes
COLORS = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
HEIGHT = 130  # [pixels] of a plot
PACE = 0.5  # [s] of wall time over which the speed is measured


class Controls:
    """The panel.

    What is asked for is put into `commands`, to be done between two steps: viser calls back from threads of its own.
    actuators: the sliders of those that have a range, by number.  taxels: pictures of maps, and where they are shown.
    """

    def __init__(self, server: ViserServer, simulation: Simulation, commands: Commands) -> None:
        self._server, self._simulation, self._commands = server, simulation, commands
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label("mjframes")
        gui.main_panel.dock_right()
        self._status = gui.add_markdown("")
        self._keyframe = self._add_keyframes()
        self._on(gui.add_button_group("time", ("run", "pause", "step", "reset")), self.do)
        speed = gui.add_slider("speed", 0.05, 2.0, 0.05, simulation.speed, hint="Simulated time per time.")
        self._on(speed, simulation.set_speed)
        self._cameras = views(simulation.model, simulation.data)
        self._camera = gui.add_dropdown("camera", tuple(self._cameras))
        self._camera.on_update(self._look)
        self._add_materials()
        self.actuators = self._add_actuators()
        self._energy = self._plot("energy [J]", ["kinetic", "potential", "elastic", "total"])
        curves = [*(f"on {name}" for name in simulation.bodies), "others"]
        self._forces = self._plot("contact force [N]", curves)
        self.taxels = [
            (picture, gui.add_image(picture.draw(simulation.data), label=picture.taxels.name))
            for picture in map(TaxelPicture, taxel_maps(simulation.model))
        ]
        with gui.add_folder("Mouse", expand_by_default=False):
            gui.add_markdown("Drag what moves with the left button: a spring pulls it.")
            spring = gui.add_number("spring [N/m]", simulation.stiffness, min=0.0, step=1e-3)
            self._on(spring, lambda value: setattr(simulation, "stiffness", value))
        self._begun, self._factor = (time.perf_counter(), 0.0), 0.0

    def show(self) -> None:
        """Show the present numbers and curves."""
        simulation = self._simulation
        now, then = time.perf_counter(), simulation.data.time
        if now - self._begun[0] > PACE:
            self._factor = max(0.0, then - self._begun[1]) / (now - self._begun[0])
            self._begun = now, then
        if simulation.diverged:
            self._follow()
        self._status.content = _status(simulation, self._factor)
        for picture, image in self.taxels:
            image.image = picture.draw(simulation.data)
        past = list(simulation.past)
        if len(past) > 1:
            times = np.array([instant.time for instant in past])
            base = past[0].potential
            energy = [(i.kinetic, i.potential - base, sum(i.elastic.values()), i.total - base) for i in past]
            forces = [(*i.soft_force.values(), i.rigid_force) for i in past]
            self._energy.data = (times, *np.array(energy).T)
            self._forces.data = (times, *np.array(forces).T)

    def view(self) -> View:
        """Return the camera that is chosen."""
        return self._cameras[self._camera.value]

    def _on(self, handle: Any, action: Callable[[Any], None]) -> None:
        """Let an action be done with the handle's value when a page changes it."""

        async def later(event: Any) -> None:  # a coroutine: those are called in order
            if event.client is not None:
                value = event.target.value
                self._commands.put(lambda: action(value))

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(later)

    async def _look(self, event: Any) -> None:
        """Let the page that chose a camera look through it."""
        if event.client is not None:
            aim(event.client.camera, self.view())

    def do(self, what: str) -> None:
        """Do what a button of the row "time" says: run, pause, step, reset."""
        simulation = self._simulation
        if what == "reset":
            simulation.reset(self._keyframe())
            self._follow()
            return
        simulation.paused = what != "run"
        simulation.diverged = False
        if what == "step":
            simulation.step()

    def _follow(self) -> None:
        """Show what the actuators are set to where that is not the sliders' doing."""
        for k, slider in self.actuators.items():
            slider.value = float(np.clip(self._simulation.data.ctrl[k], slider.min, slider.max))

    def _add_keyframes(self) -> Callable[[], int | None]:
        """A choice of what to go back to, where there are keyframes; return what gives the chosen one."""
        model = self._simulation.model
        keys = {model.key(k).name or f"keyframe {k}": k for k in range(model.nkey)}
        if not keys:
            return lambda: None
        chosen = self._server.gui.add_dropdown("reset to", (START, *keys))
        return lambda: keys.get(chosen.value)

    def _add_materials(self) -> None:
        """Sliders of how stiff each material is and how damped each body, where the model has factors of them."""
        model = self._simulation.model
        for name, body in self._simulation.bodies.items():
            known = scaling.materials(model, name)
            if not known:
                continue
            factors = dict(zip(known, scaling.stiffness(model, name, len(known)).tolist(), strict=True))
            with self._server.gui.add_folder(name):
                for label, called in known.items():
                    stiffen = partial(self._stiffen, name, factors, label)
                    self._add_factor(called or f"label {label}", "Stiffness", factors[label], stiffen)
                damping = scaling.damping(model, name)
                for place in np.flatnonzero(body.damping).tolist():
                    letter = "αβ"[place]
                    damp = partial(self._damp, name, damping, place)
                    self._add_factor(f"damping {letter}", f"Rayleigh's {letter}", damping[place], damp)

    def _stiffen(self, name: str, factors: dict[int, float], label: int, factor: float) -> None:
        factors[label] = factor
        scaling.scale(self._simulation.model, name, materials=factors)

    def _damp(self, name: str, factors: NDArray[np.float64], place: int, factor: float) -> None:
        factors[place] = factor
        scaling.scale(self._simulation.model, name, damping=factors)

    def _add_factor(self, label: str, what: str, now: float, action: Callable[[float], None]) -> None:
        """A slider of a factor, with a box to type it into; its label has the factor as well."""
        marks = ((SOFTEST, f"×{SOFTEST:g}"), 1.0, (STIFFEST, f"×{STIFFEST:g}"))
        start = float(np.clip(now, SOFTEST, STIFFEST))
        hint = f"{what}, as a multiple of what was built."
        slider = self._server.gui.add_slider(
            f"{label} ×{now:.2f}", SOFTEST, STIFFEST, 0.01, start, marks=marks, hint=hint
        )

        def changed(factor: float) -> None:
            slider.label = f"{label} ×{factor:.2f}"
            action(factor)

        self._on(slider, changed)

    def _add_actuators(self) -> dict[int, GuiSliderHandle[float]]:
        model, data = self._simulation.model, self._simulation.data
        ranged = [k for k in range(model.nu) if model.actuator_ctrllimited[k]]
        sliders: dict[int, GuiSliderHandle[float]] = {}
        if not ranged:
            return sliders
        names = control_names(model)
        with self._server.gui.add_folder("Actuators"):
            for k in ranged:
                low, high = model.actuator_ctrlrange[k].tolist()
                value = float(np.clip(data.ctrl[k], low, high))
                label = names[k] or f"control {k}"
                sliders[k] = self._server.gui.add_slider(label, low, high, (high - low) / 200, value)
                self._on(sliders[k], lambda value, k=k: data.ctrl.__setitem__(k, value))
        return sliders

    def _plot(self, title: str, names: list[str]) -> GuiUplotHandle:
        lines = [{"label": name, "stroke": COLORS[k % len(COLORS)], "width": 1.5} for k, name in enumerate(names)]
        return self._server.gui.add_uplot(
            (np.zeros(2),) * (len(names) + 1),
            ({"label": "time [s]"}, *lines),  # type: ignore[arg-type]
            title=title,
            scales={"x": {"time": False}},
            legend={"live": False},
            height=HEIGHT,
        )


def _status(simulation: Simulation, factor: float) -> str:
    if simulation.diverged:
        return "**The simulation diverged and was set back.** Try softer materials, or a smaller timestep in the scene."
    force = float(np.linalg.norm(simulation.force))
    pull = f", pulled by {force:.2g} N" if simulation.held else ""
    pace = "paused" if simulation.paused else f"{factor:.2f} × real time"
    return f"{simulation.data.time:.2f} s, {pace}, {simulation.data.ncon} contacts{pull}"
