"""The viewer: what is held moves as the skin does, time keeps to the clock, and a page shows what the sliders do."""

from __future__ import annotations

import asyncio
import importlib.metadata
import importlib.util
import io
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled, felt_block, lump

from examples.steak import draw_veins
from mjframes.app.dented import skin_vertices
from mjframes.app.drawn import BANDS, skin_faces
from mjframes.app.view import simulation as clock
from mjframes.app.view.cameras import FREE, views
from mjframes.app.view.grip import grip_body, grip_skin
from mjframes.app.view.guard import answers, point_in
from mjframes.app.view.page import Page, page
from mjframes.app.view.simulation import PAST, RATE, Simulation
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.cli.commands import main
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.scaling import damping, scale, stiffness
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

CHROMIUM = shutil.which("chromium")
# WebGL by the processor: there is no graphics card to count on
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE = 2400  # looks, 50 ms apart at least, before a page is given up that a busy machine draws
PANEL = 330  # [pixels] of the page's width that its panel leaves free
ROOM = """
<mujoco>
  <worldbody>
    <camera name="side" pos="0 -2 .5" xyaxes="1 0 0 0 0 1" fovy="30"/>
    <geom type="plane" size="0 0 .1"/>
    <body name="box" pos="0 0 .5"><freejoint/><geom type="box" size=".1 .1 .1" mass="2"/></body>
  </worldbody>
  <keyframe><key name="high" qpos="0 0 3 1 0 0 0"/></keyframe>
</mujoco>
"""
SHAPES = """
<mujoco>
  <asset>
    <hfield name="hills" nrow="3" ncol="4" size="1 1 .1 .1" elevation="0 1 0 1  0 0 0 0  1 1 1 0"/>
    <mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/>
  </asset>
  <worldbody>
    <light dir="1 0 -1" type="directional"/>
    <geom type="plane" size="0 2 .1"/><geom type="hfield" hfield="hills" pos="5 0 0"/>
    <geom type="box" size="9 9 9" pos="0 0 30" group="3"/>
    <body pos="0 0 1">
      <freejoint/>
      <geom type="sphere" size=".1"/><geom type="ellipsoid" size=".1 .2 .3"/>
      <geom type="box" size=".1 .1 .1" rgba="1 0 0 .5"/><geom type="capsule" size=".03 .2"/>
      <geom type="cylinder" size=".04 .1"/><geom type="mesh" mesh="wedge"/>
    </body>
  </worldbody>
</mujoco>
"""
SHELF = """<mujoco><worldbody>
  <light pos="0 -1 1" dir="0 1 -1" castshadow="false"/><camera pos="0 -.4 0" xyaxes="1 0 0 0 0 1"/>
</worldbody></mujoco>"""


def room(xml: str = ROOM) -> Simulation:
    return Simulation(mujoco.MjModel.from_xml_string(xml), [])


def cantilever() -> mujoco.MjModel:
    """A bar along x, of rubber with a stripe of foam, held at its left end, red before white."""
    labels = np.ones((16, 3, 4), int)
    labels[:, 1] = 2
    held = np.zeros(labels.shape, bool)
    held[0] = True
    red = (0.8, 0.0, 0.0, 1)
    materials = {1: Material(6e4, 0.4, 1000, name="rubber", rgba=red), 2: Material(2e4, 0.4, 1000, "foam", rgba=red)}
    volume = Volume.from_labels(labels, 0.01, materials)
    body = build(volume, 3, supports=[Fixed(held)], damping=(0.0, 0.05))
    return compiled(SHELF, (body, (-0.08, 0, 0), (1, 0, 0, 0)))[0]


def labelled(shown: Page, label: str) -> Any:
    """The panel's input of that label.  Raise LookupError where there is none."""
    for handle in shown.server.gui._gui_input_handle_from_uuid.values():
        if getattr(handle, "label", None) == label:
            return handle
    raise LookupError(label)


def move(shown: Page, handle: Any, value: object) -> None:
    """Set an input as a browser does, and do what it asks for."""
    handle.value = value
    event = SimpleNamespace(client=object(), target=handle)
    for callback in handle._impl.update_cb:
        asyncio.run(callback(event))
    while not shown._commands.empty():
        shown._commands.get()()


def visit(shown: Page) -> None:
    """Come as a browser does."""
    client: Any = SimpleNamespace()
    for callback in shown.server._client_connect_cb:
        if asyncio.iscoroutinefunction(callback):
            asyncio.run(callback(client))


def test_a_held_point_moves_as_its_skin_does() -> None:
    """Its Jacobian is that of MuJoCo's deformed skin, so that the force on it does the work that it should."""
    model, data = compiled(FLOOR, (lump(), (0.1, 0.2, 0.3), (0.9, 0.3, -0.2, 0.25)))
    rng = np.random.default_rng(0)
    data.qpos[:] = 0.01 * rng.normal(size=model.nq)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 0)
    vertices = [found.copy() for found in skin_vertices(model, data, scene)]
    assert model.nskin > 1
    for skin in range(model.nskin):
        vertex = len(vertices[skin]) // 2
        grip = grip_skin(model, data, skin, vertices[skin], vertices[skin][vertex])
        assert grip.position(data) == pytest.approx(vertices[skin][vertex], abs=1e-5)
        assert len(grip.point.bodies) >= 4
        assert grip.mass == pytest.approx(model.body_subtreemass[0], rel=1e-6)
        direction = rng.normal(size=model.nv)
        force = grip.pull(model, data, grip.position(data) + np.array([0.01, 0, 0.02]), 5.0)
        assert data.qfrc_applied @ direction == pytest.approx(force @ grip.jacobian(model, data) @ direction)
        moved = mujoco.MjData(model)
        moved.qpos[:] = data.qpos
        mujoco.mj_integratePos(model, moved.qpos, direction, 1e-3)
        mujoco.mj_forward(model, moved)
        expected = skin_vertices(model, moved, scene)[skin][vertex] - vertices[skin][vertex]
        assert 1e-3 * grip.jacobian(model, data) @ direction == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("young", [1e3, 1e9])
def test_the_spring_is_stable_however_stiff_it_is(young: float) -> None:
    volume = Volume.from_labels(np.ones((6, 3, 3), int), 0.01, {1: Material(young, 0.4, 1000)})
    model, data = compiled("<mujoco><option gravity='0 0 0'/></mujoco>", (build(volume, 2), (0, 0, 0), (1, 0, 0, 0)))
    mujoco.mj_forward(model, data)
    vertices = skin_vertices(model, data, mujoco.MjvScene(model, 0))[0]
    grip = grip_skin(model, data, 0, vertices, np.array([0.06, 0.03, 0.03]))
    way = np.array([0.05, -0.02, 0.03])
    target, away = grip.position(data) + way, []
    for _ in range(2000):
        grip.pull(model, data, target, 1e12)
        mujoco.mj_step(model, data)
        away.append(np.linalg.norm(grip.position(data) - target))
    assert not any(warning.number for warning in data.warning)
    assert max(away[1000:]) < 0.1 * np.linalg.norm(way)  # it swings about there


def test_a_rigid_body_is_held_where_it_is_gripped() -> None:
    run = room()
    corner = grip_body(run.model, run.data, 1, np.array([0.1, 0.1, 0.6]))
    assert corner.position(run.data) == pytest.approx([0.1, 0.1, 0.6])
    grip = grip_body(run.model, run.data, 1, np.array([0, 0, 0.5]))
    assert grip.mass == grip.inertia == pytest.approx(2)
    assert corner.inertia < 1
    run.hold(grip)
    run.target = np.array([0, 0, 1.0])
    for _ in range(2000):
        run.step()
    assert run.force == pytest.approx([0, 0, 2 * 9.81], abs=0.1)  # it hangs there
    assert run.data.qpos[2] > 0.5
    run.release()
    run.step()
    assert not run.data.qfrc_applied.any()
    assert not run.force.any()


class Clock:
    """Wall time that passes when it is told to, and a little with each look."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        self.now += 1e-6
        return self.now


def test_time_keeps_to_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = Clock()
    monkeypatch.setattr(clock, "time", wall)
    run = room()
    for _ in range(30):
        wall.now += 1 / 30
        run.advance(1.0)
    assert run.data.time == pytest.approx(1.0, abs=0.004)
    run.paused = True
    wall.now += 5
    assert run.advance(1.0) == 0
    run.paused = False
    run.set_speed(0.5)
    for _ in range(30):
        wall.now += 1 / 30
        run.advance(1.0)
    assert run.data.time == pytest.approx(1.5, abs=0.006)
    wall.now += 100  # the machine was busy: what is lost is not caught up with
    assert run.advance(1e-4) > 0
    before = run.data.time
    wall.now += 1 / 30
    run.advance(1.0)
    assert run.data.time - before == pytest.approx(0.5 / 30, abs=0.004)


def test_a_scene_goes_back_to_its_start_or_a_keyframe() -> None:
    run = room()
    for _ in range(100):
        run.step()
    assert len(run.past) == pytest.approx(0.2 * RATE, abs=1)
    assert run.past.maxlen == PAST * RATE
    run.reset(0)
    assert run.data.qpos[2] == 3
    assert not run.past
    run.reset()
    assert run.data.qpos[2] == 0.5


def test_what_diverges_is_set_back_and_halted() -> None:
    run = room(ROOM.replace('size=".1 .1 .1" mass="2"/>', 'size=".1 .1 .1" mass="2"/><site name="s"/>'))
    messages: list[str] = []
    mujoco.set_mju_user_warning(messages.append)
    try:
        run.data.qvel[0] = np.nan
        assert run.advance(10.0) in (0, 1)
    finally:
        mujoco.set_mju_user_warning(None)
    assert run.diverged
    assert run.paused
    assert run.data.qpos[2] == 0.5
    assert not run.data.warning.number.any()


def test_cameras_are_the_scenes_and_a_free_one() -> None:
    run = room()
    found = views(run.model, run.data)
    assert list(found) == ["side", FREE]
    side = found["side"]
    assert side.position == pytest.approx([0, -2, 0.5])
    assert side.angle == pytest.approx(np.radians(30))
    assert side.target[[0, 2]] == pytest.approx([0, 0.5])
    assert side.target[1] > -2
    free, camera = found[FREE], mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(run.model, camera)
    assert free.target == pytest.approx(camera.lookat)
    assert np.linalg.norm(free.position - free.target) == pytest.approx(camera.distance)
    assert free.position[2] > free.target[2]


def test_a_page_needs_viser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MjframesError, match=r'needs viser, which is not installed; pip install "mjframes\[view\]"\.$'):
        page({"room": mujoco.MjModel.from_xml_string(ROOM)}).__enter__()


needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")


@needs_viser
def test_everything_is_on_the_page_and_follows_its_body() -> None:
    """Geoms of each type, those of hidden groups left out; the lamp; and what stands still cannot be drawn away."""
    import viser

    model = mujoco.MjModel.from_xml_string(SHAPES)
    with page({"shapes": model}, port=0) as shown:
        run, scene = shown.simulation, shown.stage
        assert [body for _, body in scene.rigid] == [1] * 8  # a capsule is three
        shapes = {node.name: node for node, _ in scene.rigid}
        kinds = {kind: len(list(found)) for kind, found in groupby(sorted(type(n).__name__ for n in shapes.values()))}
        assert kinds == {"BoxHandle": 1, "CylinderHandle": 2, "IcosphereHandle": 4, "MeshHandle": 1}
        ends = [shapes[f"/bodies/1/6/{k}"].position[2] for k in (1, 2)]
        assert ends == pytest.approx([-0.2, 0.2])
        box, wedge = shapes["/bodies/1/5/0"], shapes["/bodies/1/8/0"]
        assert isinstance(box, viser.BoxHandle)
        assert isinstance(wedge, viser.MeshHandle)
        assert tuple(box.color) == (255, 0, 0)
        assert box.opacity == pytest.approx(0.5)
        assert wedge.vertices.shape == (4, 3)
        for _ in range(50):
            run.step()
        scene.draw(run.data)
        frame = shown.server.scene.get_handle_by_name("/bodies/1")
        assert frame is not None
        assert frame.position == pytest.approx(run.data.xpos[1])
        assert frame.wxyz == pytest.approx(run.data.xquat[1])
        assert run.data.xpos[1, 2] < 0.99
        names = {f"/bodies/0/{geom}/{part}" for geom, part in ((0, "0"), (0, "0/lines"), (1, "0"))} | {"/lights/0"}
        assert all(shown.server.scene.get_handle_by_name(name) is not None for name in names)
        assert shown.server.scene.get_handle_by_name("/bodies/0/2") is None


@needs_viser
def test_the_maps_of_taxels_are_on_the_page() -> None:
    with page({"felt": felt_block()}, port=0) as shown:
        images = [image for _, image in shown.controls.taxels]
        assert [image.label for image in images] == ["block_pressure", "block_traction"]
        assert not images[0].image.any()
        for _ in range(200):
            shown.simulation.step()
        shown.controls.show()
        for image in images:
            assert image.image.shape == (64, 128, 3)
            assert image.image.max() == 255


@needs_viser
def test_sliders_of_actuators_follow_a_reset() -> None:
    lift = '<actuator><general joint="up" ctrlrange="-1 2"/></actuator>'
    moved = ROOM.replace("<keyframe>", f"{lift}<keyframe>")
    moved = moved.replace("<freejoint/>", '<joint name="up" type="slide" axis="0 0 1"/>')
    moved = moved.replace('qpos="0 0 3 1 0 0 0"', 'qpos="3" ctrl="1.5"')
    with page({"room": mujoco.MjModel.from_xml_string(moved)}, port=0) as shown:
        slider, data = shown.controls.actuators[0], shown.simulation.data
        assert (slider.min, slider.max, slider.value) == (-1, 2, 0)
        shown.controls.do("step")
        assert shown.simulation.paused
        assert data.time == pytest.approx(0.002)
        shown.simulation.reset(0)
        assert data.ctrl[0] == 1.5
        slider.value = 1.0
        shown.controls.do("reset")
        assert slider.value == data.ctrl[0] == 0
        assert data.time == 0


@needs_viser
def test_sliders_of_materials_are_factors() -> None:
    """From a tenth to ten, shown as such in the label and in the box, and what the model is scaled by."""
    with page({"bar": cantilever()}, port=0) as shown:
        slider = labelled(shown, "rubber ×1.00")
        assert (slider.min, slider.max, slider.value) == (0.1, 10, 1)
        move(shown, slider, 0.5)
        assert slider.label == "rubber ×0.50"
        assert stiffness(shown.simulation.model, "soft0", 2) == pytest.approx([0.5, 1])


@needs_viser
def test_sliders_begin_with_the_factors_of_the_scene() -> None:
    model = cantilever()
    scale(model, "soft0", 3, damping=(1, 4))
    with page({"bar": model}, port=0) as shown:
        assert labelled(shown, "foam ×3.00").value == 3
        move(shown, labelled(shown, "damping β ×4.00"), 2)
        assert damping(shown.simulation.model, "soft0") == pytest.approx([1, 2])
        with pytest.raises(LookupError):
            labelled(shown, "damping α ×1.00")  # the body has none


@needs_viser
def test_nothing_moves_before_a_browser_comes() -> None:
    stop = threading.Event()
    with page({"room": mujoco.MjModel.from_xml_string(ROOM)}, port=0) as shown:
        assert shown.simulation.paused
        loop = threading.Thread(target=shown.run, args=(stop,))
        loop.start()
        try:
            time.sleep(0.3)
            assert shown.simulation.data.time == 0
            visit(shown)
            for _ in range(PATIENCE):
                if shown.simulation.data.time > 0:
                    break
                time.sleep(0.05)
            assert shown.simulation.data.time > 0
        finally:
            stop.set()
            loop.join()


@needs_viser
def test_a_page_of_several_scenes_has_a_list_of_them() -> None:
    """What is chosen is shown instead, and each goes on where it was left."""
    scenes = {"room": mujoco.MjModel.from_xml_string(ROOM), "bar": cantilever()}
    with page(scenes, port=0) as shown:
        for _ in range(10):
            shown.simulation.step()
        chooser = labelled(shown, "scene")
        assert (chooser.options, chooser.value) == (("room", "bar"), "room")
        move(shown, chooser, "bar")
        assert shown.simulation.model is scenes["bar"]
        assert shown.server.scene.get_handle_by_name("/bodies/1/1/box") is None
        assert shown.server.scene.get_handle_by_name("/skins/0/0") is not None
        assert labelled(shown, "rubber ×1.00").value == 1
        assert labelled(shown, "scene").value == "bar"
        move(shown, labelled(shown, "scene"), "room")
        assert shown.simulation.data.time == pytest.approx(0.02)
        assert shown.server.scene.get_handle_by_name("/skins/0/0") is None
    with page({"bar": cantilever()}, port=0) as shown, pytest.raises(LookupError):
        labelled(shown, "scene")


def test_windows_of_several_scenes_open_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import mujoco.viewer

    opened: list[int] = []
    monkeypatch.setattr(mujoco.viewer, "launch", lambda model: opened.append(model.ngeom))
    monkeypatch.setenv("DISPLAY", ":0")
    for name, xml in (("room", ROOM), ("shapes", SHAPES)):
        (tmp_path / f"{name}.xml").write_text(xml)
    assert main(["view", *(str(tmp_path / f"{name}.xml") for name in ("shapes", "room", "shapes"))]) == 0
    assert opened == [9, 2]


@needs_viser
def test_veins_are_on_the_page() -> None:
    """A veined skin is drawn in pieces of several colours that together have all of its triangles, and follow it."""
    meat = Material(6e4, 0.4, 1000, name="meat", rgba=(0.6, 0, 0, 1))
    spec, volume = mujoco.MjSpec(), Volume.from_labels(np.ones((8, 8, 3), int), 0.01, {1: meat})
    attach(spec, build(volume, 2), "soft")
    draw_veins(spec, "soft", {"meat": (1, 1, 1)})
    model = spec.compile()
    with page({"meat": model}, port=0) as shown:
        pieces = shown.stage.skins
        shades = sorted(int(piece.node.color[1]) for piece in pieces)
        assert 3 <= len(pieces) <= BANDS
        assert shades[0] < 30
        assert shades[-1] > 200
        drawn = np.concatenate([piece.used[piece.node.faces] for piece in pieces])
        assert sorted(map(tuple, drawn)) == sorted(map(tuple, skin_faces(model, 0)))
        for _ in range(50):
            shown.simulation.step()
        shown.stage.draw(shown.simulation.data)
        for piece in pieces:
            assert piece.node.vertices == pytest.approx(shown.stage.vertices[0][piece.used])
            assert piece.node.vertices[:, 2].max() < 0.03


@needs_viser
def test_sliders_of_several_controls_of_an_actuator_have_its_name() -> None:
    """As `--ctrl` names them; and those after it have theirs: there are more controls than actuators."""
    arm = """<body pos="2 0 0"><joint name="lift" axis="0 1 0"/><geom size=".1"/>
      <body pos="1 0 0"><joint name="wrist" type="ball"/><geom size=".1"/></body></body></worldbody><actuator>
      <orientation name="turn" joint="wrist" kp="1" ctrlrange="-1 1"/>
      <general joint="lift" ctrlrange="-1 2"/></actuator>"""
    with page({"arm": mujoco.MjModel.from_xml_string(ROOM.replace("</worldbody>", arm))}, port=0) as shown:
        sliders = shown.controls.actuators
        assert [sliders[k].label for k in sorted(sliders)] == ["turn:0", "turn:1", "turn:2", "control 3"]
        assert sliders[3].max == 2


@needs_viser
def test_a_port_that_is_taken_ends_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.xml").write_text(ROOM)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["view", str(tmp_path / "scene.xml"), "--web", "--port", str(port)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == (
        f"mjframes: nothing can be served at 127.0.0.1:{port} (Address already in use); "
        "give another --port, or 0 for any that is free.\n"
    )


@needs_viser
def test_a_page_ends_with_an_interrupt(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(ROOM)
    command = [sys.executable, "-m", "mjframes", "view", str(tmp_path / "scene.xml"), "--web", "--port", "0"]
    heeding = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # a shell's background jobs ignore it
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heeding
    ) as served:
        try:
            assert served.stdout is not None
            assert "open http://127.0.0.1:" in served.stdout.readline()
            served.send_signal(signal.SIGINT)
            rest, complaints = served.communicate(timeout=50)
        finally:
            served.kill()
    assert served.returncode == 0
    assert (rest, complaints) == ("", "")


@pytest.mark.parametrize(
    ("served", "host", "origin", "expected"),
    [
        ("127.0.0.1", "127.0.0.1:8080", None, True),
        ("127.0.0.1", "localhost:9000", "http://localhost:9000", True),
        ("127.0.0.1", "evil.example:8080", None, False),
        ("127.0.0.1", "evil.example:8080", "http://evil.example:8080", False),
        ("127.0.0.1", "127.0.0.1:8080", "http://evil.example", False),
        ("127.0.0.1", "127.0.0.1:8080", "null", False),
        ("127.0.0.1", None, None, False),
        ("127.0.0.1", "[", None, False),
        ("0.0.0.0", "lab.example:8080", "http://lab.example:8080", True),
        ("0.0.0.0", "lab.example:8080", "http://evil.example", False),
    ],
)
def test_a_page_answers_its_own_host_and_origin(
    served: str, host: str | None, origin: str | None, expected: bool
) -> None:
    assert answers(served, host, origin) == expected


@needs_viser
def test_a_page_survives_what_strangers_send() -> None:
    """Other sites are refused; malformed and huge messages, and twenty clients, leave it as it was."""
    from websockets.exceptions import ConnectionClosed, InvalidStatus
    from websockets.sync.client import connect
    from websockets.typing import Origin, Subprotocol

    with page({"room": mujoco.MjModel.from_xml_string(ROOM)}, port=0) as shown:
        url = f"ws://127.0.0.1:{shown.port}"
        offered = [Subprotocol(f"viser-v{importlib.metadata.version('viser')}")]
        with pytest.raises(InvalidStatus, match="403"):
            connect(url, origin=Origin("http://evil.example"), subprotocols=offered)
        for content in (b"", b"\xc1", b"\x81\xa4type\xa4none", bytes(2**23), "text", "[" * 5000):
            with connect(url, subprotocols=offered, max_size=None) as client, suppress(ConnectionClosed):
                client.send(content)
                client.recv(timeout=5)
        with ExitStack() as stack:
            clients = [stack.enter_context(connect(url, subprotocols=offered, max_size=None)) for _ in range(20)]
            for client in clients:
                assert client.recv(timeout=20)
            assert len(shown.server.get_clients()) <= 20
        shown.controls.do("step")
        shown.stage.draw(shown.simulation.data)
        assert shown.simulation.data.time == pytest.approx(0.002)


@contextmanager
def visited(shown: Page) -> Iterator[Callable[..., None]]:
    """What sends a message as a browser does, once it has come; in the end all have been heard."""
    import msgspec
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    camera: dict[str, Any] = {"wxyz": [1, 0, 0, 0], "position": [0, -1, 1], "fov": 1.0, "near": 0.1, "far": 9.0}
    camera |= {"image_height": 100, "image_width": 100, "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}
    offered = [Subprotocol(f"viser-v{importlib.metadata.version('viser')}")]
    with connect(f"ws://127.0.0.1:{shown.port}", subprotocols=offered, max_size=None) as client:

        def send(kind: str, **fields: Any) -> None:
            client.send(msgspec.msgpack.encode({"type": kind, **fields}))

        send("ViewerCameraMessage", **camera)
        for _ in range(PATIENCE):
            if shown.server.get_clients():
                break
            time.sleep(0.05)
        heard = shown.server.gui.add_text("heard", "")
        yield send
        send("GuiUpdateMessage", uuid=heard._impl.uuid, updates={"value": "all"})
        for _ in range(PATIENCE):
            if heard.value == "all":
                return
            time.sleep(0.05)
    raise LookupError("the page hears no more")


STRANGE = [
    500,
    -500,
    1e308,
    -1e308,
    2**63,
    np.inf,
    -np.inf,
    np.nan,
    "500",
    "",
    "run",
    None,
    True,
    [],
    [1.0],
    {"a": [{}]},
]


@needs_viser
def test_inputs_take_only_what_they_can_have(capfd: pytest.CaptureFixture[str]) -> None:
    """Whatever comes for sliders, numbers, lists and buttons, and for what is no value: clamped, or left as it was."""
    models = {"bar": cantilever(), "room": mujoco.MjModel.from_xml_string(ROOM)}
    stop = threading.Event()
    with page(models, port=0) as shown:
        loop = threading.Thread(target=shown.run, args=(stop,))
        loop.start()
        inputs = dict(shown.server.gui._gui_input_handle_from_uuid)
        sliders = [labelled(shown, label) for label in ("speed", "rubber ×1.00", "foam ×1.00", "damping β ×1.00")]
        spring, scenes, cameras = (labelled(shown, label) for label in ("spring [N/m]", "scene", "camera"))
        camera = cameras.value
        with visited(shown) as send:
            for uuid in inputs:
                for value in STRANGE:
                    send("GuiUpdateMessage", uuid=uuid, updates={"value": value})
                for name in ("removed", "update_cb", "props", "sync_cb", "nothing"):
                    send("GuiUpdateMessage", uuid=uuid, updates={name: None})
            send("GuiUpdateMessage", uuid=[], updates=[])
            send("GuiUpdateMessage", uuid="none", updates={"value": 1})
        stop.set()
        loop.join()
        while not shown._commands.empty():
            shown._commands.get()()
        for slider in sliders:
            assert slider.value == slider.min  # the last that can be had: -inf
        assert (spring.value, scenes.value, cameras.value) == (0, "bar", camera)
        assert not any(handle._impl.removed for handle in inputs.values())
        simulation = shown.simulation
        assert simulation.speed == 0.05
        np.testing.assert_allclose(stiffness(simulation.model, "soft0", 2), 0.1)
    assert capfd.readouterr().err == ""


@needs_viser
def test_drags_to_nowhere_move_nothing() -> None:
    with page({"bar": cantilever()}, port=0) as shown, visited(shown) as send:
        (piece, *_), simulation = shown.stage.skins, shown.simulation
        drag = {"name": piece.node.name, "instance_index": None, "start_screen_pos": [0, 0], "end_screen_pos": [0, 0]}
        drag |= {"button": "left", "modifier": None, "owner": ""}

        def move_to(phase: Any, end: Any) -> None:
            send("SceneNodeDragMessage", **drag, phase=phase, start_position=end, end_position=end)

        def act() -> None:
            for _ in range(PATIENCE):
                if not shown._commands.empty():
                    shown._commands.get()()
                    return
                time.sleep(0.05)

        shown._commands.get()()  # the visit
        move_to("start", [0, 0, 0])
        act()
        assert simulation.held is not None
        for wrong in (np.nan, np.inf, -np.inf):
            for phase in ("start", "update", "none", None, 7):
                move_to(phase, [0, wrong, 0])
        move_to("update", [1e300, 0, 0])
        act()  # the first that there is to do
        assert simulation.target[0] == 1e3 * simulation.model.stat.extent
        assert shown._commands.empty()
        simulation.step()
        move_to("end", [np.nan, 0, 0])
        act()
        assert simulation.held is None


@pytest.mark.parametrize("wrong", [["a", "b", "c"], [0, 0], [[0, 0, 0]], "abc", None, {"x": 1}, [0, 0, np.nan]])
def test_what_is_no_point_is_none(wrong: object) -> None:
    assert point_in(9.0, wrong) is None


def test_what_cannot_be_done_does_not_end_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    stop = threading.Event()

    def fail() -> None:
        raise OverflowError("too large")

    with page({"room": mujoco.MjModel.from_xml_string(ROOM)}, port=0) as shown:
        shown._commands.put(fail)
        shown._commands.put(stop.set)
        shown.run(stop)
    assert capsys.readouterr().err == "mjframes: what the page asked for cannot be done (too large).\n"


@pytest.fixture
def shown() -> Iterator[Page]:
    """A bar on a page, running."""
    pytest.importorskip("viser")
    stop = threading.Event()
    with page({"bar": cantilever()}, port=0) as bar:
        loop = threading.Thread(target=bar.run, args=(stop,))
        loop.start()
        try:
            yield bar
        finally:
            stop.set()
            loop.join()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium: apt-get install chromium")
def test_a_softer_bar_sags_on_the_page(shown: Page) -> None:
    """In a browser: a slider makes it softer, and its skin goes down there; the mouse lifts its end, and lets it go."""
    browsers = pytest.importorskip("playwright.sync_api")
    pytest.importorskip("PIL")
    from PIL import Image

    run = shown.simulation

    def wait(what: str, condition: Callable[[], bool]) -> None:
        for _ in range(PATIENCE):
            if condition():
                return
            web.wait_for_timeout(50)
        pytest.fail(f"waited in vain: {what}")

    def end() -> float:
        """Height of the free end."""
        vertices = np.concatenate(shown.stage.vertices)
        return float(vertices[vertices[:, 0].argmax(), 2])

    def at_rest() -> bool:
        return bool(run.past) and run.past[-1].speed < 1e-3

    def red() -> np.ndarray:
        """Pixels (n, 2) of the bar: row, column."""
        picture = Image.open(io.BytesIO(web.screenshot())).convert("RGB")
        r, g, b = np.moveaxis(np.asarray(picture, int)[:, :PANEL], 2, 0)
        return np.argwhere((r > 60) & (r > 2 * g) & (r > 2 * b))

    def settled(past: np.ndarray | None = None) -> np.ndarray:
        """The same where the page shows what is at rest, and no longer what was: on a busy machine it lags behind."""
        pictures = [red()]

        def same() -> bool:
            pictures.append(red())
            moved = past is None or not np.array_equal(past, pictures[-1])
            return moved and np.array_equal(pictures[-2], pictures[-1])

        wait("the page settles", same)
        return pictures[-1]

    with browsers.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        web = browser.new_page(viewport={"width": PANEL + 330, "height": 300})
        web.set_default_timeout(60_000)  # of a busy machine
        complaints: list[str] = []
        web.on("pageerror", lambda error: complaints.append(str(error)))
        web.goto(f"http://127.0.0.1:{shown.port}")
        label = web.get_by_text("rubber ×1.00", exact=True)
        label.wait_for()
        wait("the bar comes to rest", at_rest)
        before, seen = end(), settled()
        assert len(seen) > 200
        web.locator(f"[id='{label.get_attribute('for')}'] [role=slider]").press("Home")
        wait("the slider moves", lambda: stiffness(run.model, "soft0", 2) == pytest.approx([0.1, 1]))
        wait("the bar sags", lambda: end() < before - 0.01 and at_rest())
        web.get_by_text("rubber ×0.10", exact=True).wait_for()
        sagging, low = settled(seen), end()
        assert sagging[:, 0].max() > seen[:, 0].max() + 10

        row, column = sagging[sagging[:, 1] > sagging[:, 1].max() - 12].mean(axis=0).tolist()  # inside of the free end
        web.mouse.move(column, row)
        web.mouse.down()
        web.mouse.move(column, row - 20)
        wait("the mouse holds the bar", lambda: run.held is not None)
        web.mouse.move(column, row - 60)
        wait("the bar is lifted", lambda: end() > low + 0.005)
        assert run.force[2] > 0
        web.mouse.up()
        wait("the mouse lets go", lambda: run.held is None)
        assert complaints == []
        browser.close()
