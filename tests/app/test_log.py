"""Logs: MCAP's own reader and Foxglove's own schemas read them, nothing is lost, a cut-off one gives what it has."""

from __future__ import annotations

import dataclasses
import io
import json
import lzma
import math
import operator
import os
import re
import signal
import struct
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from builders.scenes import felt_block
from scipy.spatial import KDTree

from benchmarks.stability.damage import rewritten
from mjframes.app import video
from mjframes.app.dented import draw_dents, skin_vertices
from mjframes.app.log import numbers, write
from mjframes.app.log.numbers import FIELDS, instants, messages, state_message
from mjframes.app.log.options import TOPICS, Log
from mjframes.app.log.read import read_log
from mjframes.app.measure import measure, state_of
from mjframes.app.recording import STATE, Instant, State
from mjframes.app.replay import film_of, plot_of, state_at
from mjframes.app.run import record
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.packed import NUMBERS, SCENE, pack, unpack
from mjframes.scene.scene_file import standalone_scene
from mjframes.scene.view import soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

pytest.importorskip("mcap")
pytest.importorskip("mcap_protobuf")
drawing = pytest.importorskip("mjframes.app.log.drawing")

ROOM = """
<mujoco>
  <asset>
    <texture name="wood" type="2d" builtin="flat" rgb1=".2 .4 .6" width="8" height="8"/>
    <material name="wood" texture="wood" rgba="1 1 .5 1"/>
    <hfield name="hills" nrow="3" ncol="4" size="1 1 .1 .1" elevation="0 1 0 1  0 0 0 0  1 1 1 0"/>
    <mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 2 .1" material="wood"/>
    <geom name="hills" type="hfield" hfield="hills" pos="5 0 0"/>
    <geom name="hidden" type="box" size="9 9 9" pos="0 0 30" group="3"/>
    <body name="arm" pos="0 0 .5" euler="0 90 0">
      <joint name="swing" axis="0 1 0"/>
      <geom type="capsule" size=".03 .2" pos=".1 0 0"/><geom type="cylinder" size=".04 .1" pos=".3 0 0"/>
      <geom type="mesh" mesh="wedge"/><site name="tip"/>
    </body>
    <body pos="0 1 .105"><freejoint/><geom type="ellipsoid" size=".3 .2 .1" rgba="1 0 0 1"/></body>
  </worldbody>
  <actuator><position joint="swing" kp="5" timeconst=".1" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos name="angle" joint="swing"/><framepos objtype="site" objname="tip"/></sensor>
</mujoco>
"""


def decoded(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Topic → (log time, message) by the readers of others, which know of us what the file says."""
    from mcap.decoder import DecoderFactory as Base
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    class Json(Base):
        def decoder_for(self, message_encoding: str, schema: Any) -> Any:
            return json.loads if message_encoding == "json" and schema.encoding == "jsonschema" else None

    found = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory(), Json()])
        for _, channel, message, content in reader.iter_decoded_messages():
            found[channel.topic].append((message.log_time, content))
    return found


def block() -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    volume = Volume.from_labels(np.ones((6, 3, 3), int), 0.01, {1: Material(1e5, 0.4, 1000, rgba=(0.1, 0.2, 0.3, 1))})
    spec = standalone_scene(build(volume, 2), volume, name="block")
    return spec, spec.compile()


@pytest.fixture(autouse=True, scope="module")
def same_bits() -> Iterator[None]:
    """Let x264 compress the same small pictures to the same bits each time, which it does not with its `mbtree`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(video.QUALITY, "x264-params", "mbtree=0")
        yield


@pytest.fixture(scope="module")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> tuple[mujoco.MjModel, Path]:
    """A block of rubber that falls on a floor, logged with a film of its own."""
    pytest.importorskip("av")
    path = tmp_path_factory.mktemp("log") / "block.mcap"
    spec, model = block()
    record(model, 0.3, log=Log(path, topics=TOPICS), size=(96, 64), fps=50, scene=spec)
    return model, path


def test_a_log_is_chunked_compressed_and_indexed(fallen: tuple[mujoco.MjModel, Path]) -> None:
    from mcap.reader import make_reader

    with fallen[1].open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.chunk_indexes
    assert all(chunk.compression == "zstd" and chunk.message_index_offsets for chunk in summary.chunk_indexes)
    schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
    assert {topic: (schema.name, schema.encoding) for topic, schema in schemas.items()} == {
        "/state": ("mjframes.state", "jsonschema"),
        "/energy": ("mjframes.energy", "jsonschema"),
        "/soft/block": ("mjframes.soft", "jsonschema"),
        "/contacts": ("mjframes.contacts", "jsonschema"),
        "/tf": ("foxglove.FrameTransforms", "protobuf"),
        "/scene/rigid": ("foxglove.SceneUpdate", "protobuf"),
        "/scene/soft": ("foxglove.SceneUpdate", "protobuf"),
        "/scene/forces": ("foxglove.SceneUpdate", "protobuf"),
        "/video": ("foxglove.CompressedVideo", "protobuf"),
    }


def test_a_log_has_a_picture_of_each_map_of_taxels(tmp_path: Path) -> None:
    """The column in the middle of the ball is the brightest; the exact numbers are in the topic of sensors."""
    record(felt_block(), 0.4, log=Log(tmp_path / "felt.mcap", rate=20))
    found = decoded(tmp_path / "felt.mcap")
    assert [topic for topic in sorted(found) if "taxels" in topic] == [
        "/taxels/block_pressure",
        "/taxels/block_traction",
    ]
    assert len(found["/taxels/block_pressure"]) == len(found["/scene/forces"])
    now, image = found["/taxels/block_pressure"][-1]
    assert (image.width, image.height, image.encoding, image.step) == (128, 64, "rgb8", 384)
    pixels = np.frombuffer(image.data, np.uint8).reshape(64, 128, 3)
    taxels = pixels[8::16, 8::16].astype(int).sum(axis=-1)
    assert (pixels.astype(int).sum(axis=-1) == np.kron(taxels, np.ones((16, 16), int))).all()
    felt = np.reshape(dict(found["/sensors"])[now]["block_pressure"], (4, 8))[::-1]  # the first row is at the bottom
    assert (felt.argmax(axis=1) == taxels.argmax(axis=1)).all()
    assert felt.max() > 0
    np.testing.assert_allclose(taxels / taxels.max(), felt / felt.max(), atol=0.02)


def test_what_foxglove_draws_is_where_mujoco_has_it(fallen: tuple[mujoco.MjModel, Path]) -> None:
    """Skins, frames and forces of every entry, against MuJoCo's own of the state that was logged then."""
    model, path = fallen
    found = decoded(path)
    states = dict(found["/state"])
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, 1)
    touched = 0
    assert len(found["/scene/soft"]) == len(found["/tf"]) == len(found["/scene/forces"]) == 15
    entries = zip(found["/scene/soft"], found["/tf"], found["/scene/forces"], strict=True)
    for (now, skins), (_, transforms), (_, forces) in entries:
        data.qpos[:], data.qvel[:] = states[now]["qpos"], states[now]["qvel"]
        mujoco.mj_forward(model, data)
        (skin,) = skins.entities
        assert (skin.id, skin.frame_id, skin.timestamp.ToNanoseconds()) == ("block:1", "world", now)
        (triangles,) = skin.triangles
        mujoco.mjv_updateSkin(model, data, scene)
        draw_dents(model, data, scene)
        points = [(p.x, p.y, p.z) for p in triangles.points]
        assert points == pytest.approx(np.reshape(scene.skinvert, (-1, 3)), abs=drawing.ROUNDING * 0.062 / 2)
        assert list(triangles.indices) == model.skin_face.ravel().tolist()  # it has few: none is left out
        assert [triangles.color.r, triangles.color.g, triangles.color.b] == pytest.approx([0.1, 0.2, 0.3])
        for transform in transforms.transforms:
            body = data.body(transform.child_frame_id)
            assert transform.parent_frame_id == "world"
            place, turn = transform.translation, transform.rotation
            assert [place.x, place.y, place.z] == pytest.approx(body.xpos, abs=1e-12)
            assert [turn.w, turn.x, turn.y, turn.z] == pytest.approx(body.xquat, abs=1e-12)
        (arrows,) = (entity.arrows for entity in forces.entities)
        total = np.zeros(3)
        for arrow in arrows:
            q, turned = arrow.pose.orientation, np.zeros(3)
            mujoco.mju_rotVecQuat(turned, np.array([1.0, 0, 0]), np.array([q.w, q.x, q.y, q.z]))
            total += (arrow.shaft_length + arrow.head_length) * turned * model.stat.meanmass / model.vis.map.force
        on_body = soft(model, data, "block").patch_forces.sum(axis=0)
        assert total == pytest.approx(on_body, rel=1e-3, abs=1e-6)
        touched += len(arrows)
    assert touched > 0


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> tuple[mujoco.MjModel, Path]:
    """A ball of 12 cm, its halves of two materials, that falls on a floor and filmed."""
    pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("ball")
    x, y, z = np.indices((30, 30, 30)) - 14.5
    labels = np.where(x**2 + y**2 + z**2 < 15**2, np.where(x > 0, 1, 2), 0)
    halves = {n: Material(2e4, 0.4, 1000, name=name) for n, name in ((1, "left"), (2, "right"))}
    volume = Volume.from_labels(labels, 0.004, halves)
    spec = standalone_scene(build(volume, 3), volume, name="ball")
    model = spec.compile()
    record(model, 1.0, video=folder / "a.mp4", log=folder / "a.mcap", size=(96, 64), scene=spec)
    return model, folder


def test_rigid_geoms_are_said_once_in_their_bodies_frames(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(ROOM)
    record(model, 0.2, log=Log(tmp_path / "a.mcap", topics=("scene",)))
    logged = decoded(tmp_path / "a.mcap")
    assert set(logged) == {"/scene/rigid", "/scene/forces", "/tf"}
    ((now, update),) = logged["/scene/rigid"]
    assert now == 0
    room, arm, ball = update.entities
    assert [(entity.frame_id, entity.frame_locked) for entity in update.entities] == [
        ("world", True),
        ("arm", True),
        ("body_2", True),
    ]
    (floor,) = room.cubes  # and not what is hidden
    assert floor.size.x == pytest.approx(8 * model.stat.extent)
    assert floor.size.y == 4
    assert floor.pose.position.z == pytest.approx(-floor.size.z / 2)
    assert [floor.color.r, floor.color.g, floor.color.b] == pytest.approx([0.2, 0.4, 0.3], abs=0.01)
    (hills,) = room.triangles
    assert len(hills.points) == 12
    assert len(hills.indices) == 3 * 12
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for point in hills.points:  # where MuJoCo's rays meet it, seen from above
        above = np.array([5 + 0.999 * point.x, 0.999 * point.y, 3.0])
        meeting = mujoco.mj_ray(model, data, above, np.array([0, 0, -1.0]), None, 1, -1, np.zeros(1, np.int32))
        assert 3 - meeting == pytest.approx(point.z, abs=1e-3)
    normals = normals_of(hills)
    assert (normals[:, 2] > 0).all()
    assert [size_of(cylinder) for cylinder in arm.cylinders] == [(0.06, 0.06, 0.4), (0.08, 0.08, 0.2)]
    assert [(s.pose.position.x, s.pose.position.z) for s in arm.spheres] == [(0.1, -0.2), (0.1, 0.2)]
    (wedge,) = arm.triangles
    corners = np.array([(p.x, p.y, p.z) for p in wedge.points])
    turned = np.array([rotated(wedge.pose.orientation, corner) for corner in corners])
    at = wedge.pose.position
    expected = [(0, 0, 0), (0, 0, 0.1), (0, 0.1, 0), (0.1, 0, 0)]
    found = sorted(map(tuple, (turned + np.array([at.x, at.y, at.z])).round(6) + 0.0))
    assert np.array(found) == pytest.approx(np.array(expected))
    assert size_of(ball.spheres[0]) == (0.6, 0.4, 0.2)
    assert ball.spheres[0].color.r == 1
    assert {t.child_frame_id for t in logged["/tf"][-1][1].transforms} == {"arm", "body_2"}


def normals_of(triangles: Any) -> np.ndarray:
    points = np.array([(p.x, p.y, p.z) for p in triangles.points])
    a, b, c = points[np.reshape(triangles.indices, (-1, 3))].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def size_of(shape: Any) -> tuple[float, ...]:
    return tuple(round(value, 9) for value in (shape.size.x, shape.size.y, shape.size.z))


def rotated(q: Any, vector: np.ndarray) -> np.ndarray:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, np.array(vector, float), np.array([q.w, q.x, q.y, q.z]))
    return result


def test_the_video_can_be_decoded_a_message_a_frame(fallen: tuple[mujoco.MjModel, Path]) -> None:
    av = pytest.importorskip("av")
    frames = decoded(fallen[1])["/video"]
    assert len(frames) == 15
    decoder = av.CodecContext.create("h264", "r")
    pictures = []
    for now, message in frames:
        assert (message.format, message.frame_id) == ("h264", "front")
        assert message.timestamp.ToNanoseconds() == now
        assert message.data.startswith(b"\0\0\0\1")
        if message.data[4] & 31 == 7:  # a sequence parameter set stands before each picture that needs no other
            decoder = av.CodecContext.create("h264", "r")
        pictures += decoder.decode(av.Packet(message.data))
    pictures += decoder.decode(None)
    assert len(pictures) == 15
    assert {(picture.width, picture.height) for picture in pictures} == {(96, 64)}
    assert frames[0][1].data[4] & 31 == 7


def test_numbers_are_kept_bit_by_bit(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(ROOM)
    recording = record(model, 0.4, log=tmp_path / "a.mcap", plot=tmp_path / "a.png")
    log = read_log(tmp_path / "a.mcap")
    assert log.whole
    again = log.recording()
    assert (again.steps, again.seconds, again.timestep) == (recording.steps, recording.seconds, recording.timestep)
    assert again.weight == recording.weight
    for one, other in zip(recording.instants, again.instants, strict=True):
        assert (one.time, one.total, one.speed, one.penetration, one.normal_force) == (
            *(other.time, other.total, other.speed, other.penetration, other.normal_force),
        )
    assert [state.time for state in again.states] == pytest.approx([*(np.arange(12) / 30), 0.398], abs=0.0011)
    for state in again.states:
        before = next(before for before in recording.states if before.time == state.time)
        for name in STATE:
            assert np.array_equal(getattr(before, name), getattr(state, name))
    assert recording.states[-1].act.size == 1
    sensors = log.messages["/sensors"][-1]
    assert sensors["angle"] == recording.states[-1].qpos[0]
    assert len(sensors["sensor_1"]) == 3
    pytest.importorskip("matplotlib")
    plot_of(log, tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_any_instant_comes_back_from_its_messages() -> None:
    rng = np.random.default_rng(0)
    state = State(0.3, *(np.append(rng.normal(size=size), [5e-324, -0.0, 1e308, 0.1]) for size in (3, 2, 4, 1)))
    again = json.loads(json.dumps(state_message(state)))
    for name in again:
        assert np.array(again[name]).tobytes() == getattr(state, name).tobytes()
    one = Instant(
        0.3, 1 / 3, -2 / 3, {"a": 1e-17, "b c": 0.7}, {"a": 0.1, "b c": 0.2}, 5, 1e-5, 3.3,
        {"a": 1 / 7, "b c": 2.2}, 0.1 + 0.2, 7.7,
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    said = messages(model, mujoco.MjData(model), one, TOPICS)
    logged = {topic: [json.loads(json.dumps({"time": one.time, **m}))] for topic, m in said.items()}
    (other,) = instants(logged)
    for field in dataclasses.fields(Instant):
        assert getattr(one, field.name) == getattr(other, field.name), field.name


@pytest.mark.parametrize("topic", numbers.TOPICS)
def test_a_topic_writes_the_channels_that_it_declares(topic: str, fallen: tuple[mujoco.MjModel, Path]) -> None:
    for model in (fallen[0], mujoco.MjModel.from_xml_string(ROOM)):
        data = mujoco.MjData(model)
        bodies = {name: soft(model, data, name) for name in soft_names(model)}
        mujoco.mj_forward(model, data)
        instant = measure(model, data, bodies, state_of(data), 0.0)
        declared = numbers.TOPICS[topic].fields(model, list(bodies))
        said = numbers.TOPICS[topic].messages(model, data, instant)
        assert {channel: set(fields) for channel, fields in declared.items()} == {
            channel: set(message) for channel, message in said.items()
        }


def test_a_state_is_the_nearest_one(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(ROOM)
    recording = record(model, 0.1, log=tmp_path / "a.mcap")
    log = read_log(tmp_path / "a.mcap")
    for asked, near in ((0.0611, 0.066), (0.097, 0.098)):
        state = state_at(log, asked)
        expected = next(state for state in recording.states if abs(state.time - near) < 1e-9)
        assert list(state) == ["time", "qpos", "qvel", "act", "ctrl"]
        for name in state:
            assert np.array_equal(state[name], getattr(expected, name))
    assert state_at(log, 0.1) == state_at(log, 0.098)  # the end of the run, which is the end of its last step
    with pytest.raises(MjframesError, match=r"state is asked for at 0\.2 s, but .*a\.mcap goes from 0 to 0\.098 s\."):
        state_at(log, 0.2)


def test_a_film_of_a_log_is_that_of_the_run(tmp_path: Path) -> None:
    """Of meshes that are files, taken from the log alone: what the scene was made of is gone."""
    pytest.importorskip("av")
    parts = tmp_path / "parts"
    parts.mkdir()
    trimesh.creation.box(extents=(0.2, 0.2, 0.2)).export(parts / "box.stl")
    xml = """<mujoco><compiler meshdir="parts"/><asset><mesh name="box" file="box.stl"/></asset><worldbody>
      <light pos="0 0 3"/><camera name="side" pos="0 -2 .5" xyaxes="1 0 0 0 0 1"/><geom type="plane" size="1 1 .1"/>
      <body pos="0 0 .3" euler="20 10 0"><freejoint/><geom type="mesh" mesh="box" rgba="1 0 0 1"/></body>
      </worldbody></mujoco>"""
    (tmp_path / "scene.xml").write_text(xml)
    spec = mujoco.MjSpec.from_file(str(tmp_path / "scene.xml"))
    record(spec.compile(), 0.4, video=tmp_path / "a.mp4", log=tmp_path / "a.mcap", fps=25, size=(96, 64), scene=spec)
    for path in (*parts.iterdir(), parts, tmp_path / "scene.xml"):
        path.rmdir() if path.is_dir() else path.unlink()
    film_of(read_log(tmp_path / "a.mcap"), tmp_path / "b.mp4", fps=25, size=(96, 64))
    one, other = (list(pictures_of(tmp_path / name)) for name in ("a.mp4", "b.mp4"))
    assert len(one) == 10
    assert np.abs(one[0].astype(int) - one[-1]).mean() > 1  # the box falls
    assert all(np.array_equal(before, after) for before, after in zip(one, other, strict=True))
    assert "/video" in decoded(tmp_path / "a.mcap")


def test_a_film_of_a_log_has_the_dents_that_actuators_press(tmp_path: Path) -> None:
    """They come from the contacts' forces, which replay found without the controls."""
    pytest.importorskip("av")
    volume = Volume.box((0.06, 0.06, 0.02), Material(5e4, 0.45, 1000), spacing=0.005)
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><light pos="0 0 1"/><camera name="side" pos="0 -.15 .06" xyaxes="1 0 0 0 .4 1"/>
        <body name="punch" pos="0 0 .031"><joint name="punch" type="slide" axis="0 0 1" damping="2"/>
        <geom size=".01" mass=".05" rgba="1 0 0 1"/></body></worldbody>
        <actuator><motor name="punch" joint="punch"/></actuator></mujoco>"""
    )
    attach(spec, build(volume, 2, supports=Fixed(volume.side("-z"))), "pad")
    model = spec.compile()
    options = {"fps": 25, "size": (96, 64), "camera": "side"}
    record(model, 0.3, video=tmp_path / "a.mp4", log=tmp_path / "a.mcap", scene=spec, ctrl={"punch": -2.0}, **options)
    film_of(read_log(tmp_path / "a.mcap"), tmp_path / "b.mp4", **options)
    one, other = (list(pictures_of(tmp_path / name)) for name in ("a.mp4", "b.mp4"))
    assert all(np.array_equal(before, after) for before, after in zip(one, other, strict=True))


def pictures_of(path: Path) -> Iterator[np.ndarray]:
    import av

    with av.open(str(path)) as container:
        yield from (frame.to_ndarray(format="rgb24") for frame in container.decode(video=0))


def test_a_log_without_scene_says_so(tmp_path: Path) -> None:
    record(mujoco.MjModel.from_xml_string(ROOM), 0.01, log=Log(tmp_path / "a.mcap", topics=("state",)))
    log = read_log(tmp_path / "a.mcap")
    assert set(log.messages) == {"/state"}
    with pytest.raises(MjframesError, match=r"a\.mcap: there is no scene in it"):
        film_of(log, tmp_path / "a.mp4")
    with pytest.raises(MjframesError, match=r"a\.mcap: the log has no energy; log a run with the topic energy"):
        log.recording()
    record(mujoco.MjModel.from_xml_string(ROOM), 0.01, log=Log(tmp_path / "b.mcap", topics=("energy",)))
    with pytest.raises(MjframesError, match=r"b\.mcap: the log has no states"):
        state_at(read_log(tmp_path / "b.mcap"), 0.0)


@pytest.mark.parametrize("rate", [50.0, 10.0])
def test_the_rate_is_of_numbers_and_scene(rate: float, tmp_path: Path) -> None:
    recording = record(mujoco.MjModel.from_xml_string(ROOM), 0.4, log=Log(tmp_path / "a.mcap", rate=rate))
    found = decoded(tmp_path / "a.mcap")
    for topic in ("/state", "/contacts", "/sensors", "/tf", "/scene/forces"):
        assert np.array([now for now, _ in found[topic]]) * 1e-9 == pytest.approx(np.arange(0, 0.4, 1 / rate)), topic
    assert len(recording.instants) == 200
    deepest = max(message["penetration"] for _, message in found["/contacts"])
    until = found["/contacts"][-1][1]["time"]
    assert deepest == max(i.penetration for i in recording.instants if i.time <= until) > 0


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"rate": 0.0}, "rate of the log is 0.0; it must be a positive number"),
        ({"rate": float("nan")}, "rate of the log is nan"),
        ({"topics": ()}, "topics of the log are none; give one or more of state, energy"),
        ({"topics": ("state", "sound")}, "topics of the log are state, sound; give"),
        ({"path": "a.txt"}, r"^a\.txt: a log is written as \.mcap; give the path this ending\.$"),
        ({"path": Path("mcap")}, r"^mcap: a log is written as \.mcap"),
    ],
)
def test_a_log_that_cannot_be_is_refused(keys: dict, message: str) -> None:
    with pytest.raises(MjframesError, match=message):
        Log(**{"path": "a.mcap", **keys})


def test_a_log_that_is_cut_off_gives_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mjframes.app.log.write.FLUSH", 0.0)  # a chunk a message
    recording = record(mujoco.MjModel.from_xml_string(ROOM), 0.1, log=tmp_path / "whole.mcap")
    content = (tmp_path / "whole.mcap").read_bytes()
    counts = []
    for share in (0.3, 0.45, 0.6):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(content[: int(share * len(content))])
        log = read_log(cut)
        assert not log.whole
        again = log.recording()
        assert np.isnan(again.seconds)
        for one, other in zip(recording.instants, again.instants, strict=False):
            assert (one.time, one.total) == (other.time, other.total)
        assert again.states
        assert again.steps == len(again.instants)
        counts.append(again.steps)
    assert 0 < counts[0] < counts[1] < counts[2] < recording.steps
    (tmp_path / "cut.mcap").write_bytes(content[:20])
    with pytest.raises(MjframesError, match=r"cut\.mcap: not a log that mjframes wrote \(it does not say of what\)"):
        read_log(tmp_path / "cut.mcap")
    from mcap.reader import make_reader

    monkeypatch.undo()
    record(mujoco.MjModel.from_xml_string(ROOM), 0.1, log=tmp_path / "whole.mcap")
    with (tmp_path / "whole.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    chunk = summary.chunk_indexes[0]  # the indexes that follow are not read
    damaged = bytearray((tmp_path / "whole.mcap").read_bytes())
    damaged[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    (tmp_path / "cut.mcap").write_bytes(damaged)
    with pytest.raises(MjframesError, match=r"cut\.mcap: not a log that mjframes wrote, or a damaged one"):
        read_log(tmp_path / "cut.mcap")


def test_a_log_that_is_cut_off_at_its_scene_says_so(tmp_path: Path) -> None:
    path, spec = tmp_path / "a.mcap", mujoco.MjSpec.from_string(ROOM)
    record(spec.compile(), 0.1, log=Log(path, topics=("state",)), scene=spec)
    content = path.read_bytes()
    entry = content.index(b"timestep")
    for end in (50, entry // 2, entry):
        path.write_bytes(content[:end])
        with pytest.raises(MjframesError, match=r"a\.mcap: the log was cut off before its first entry; nothing of it"):
            read_log(path)
    path.write_bytes(content[: entry + 200])
    with pytest.raises(MjframesError, match=r"a\.mcap: the log was cut off, and what is left has no states\."):
        read_log(path).states()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no such signal")
def test_a_killed_run_leaves_a_log_that_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(ROOM)
    command = [sys.executable, "-m", "mjframes", "run", str(tmp_path / "scene.xml"), "--log", str(tmp_path / "a.mcap")]
    running = subprocess.Popen([*command, "--duration", "1e5"], stderr=subprocess.DEVNULL)
    left = tmp_path / f".a.{running.pid}.partial.mcap"
    try:
        while logged_states(left) < 2:
            assert running.poll() is None
            time.sleep(0.05)
    finally:
        running.kill()
        running.wait(30)
    assert not (tmp_path / "a.mcap").exists()
    log = read_log(left)
    assert not log.whole
    assert len(log.states()) > 1
    assert unpack(log.files, "the log").nq == len(log.states()[-1]["qpos"])


def logged_states(path: Path) -> int:
    try:
        return len(read_log(path).messages.get("/state", []))
    except MjframesError:  # it is not there yet, or has only begun
        return 0


@pytest.mark.slow
def test_a_log_of_a_second_is_small(ball: tuple[mujoco.MjModel, Path]) -> None:
    model, folder = ball
    assert model.nskinvert > 4000
    with (folder / "a.mcap").open("rb") as stream:
        from mcap.reader import make_reader

        reader = make_reader(stream)
        summary = reader.get_summary()
        files = {attachment.name: len(attachment.data) for attachment in reader.iter_attachments()}
    assert summary is not None
    assert set(files) == {f"{SCENE}.xz", f"{NUMBERS}.xz"}
    messages = sum(chunk.compressed_size + chunk.message_index_length for chunk in summary.chunk_indexes)
    assert messages < 450e3
    assert files[f"{NUMBERS}.xz"] < 10e3
    assert files[f"{SCENE}.xz"] < 0.4 * len(read_log(folder / "a.mcap").files[SCENE])


@pytest.mark.slow
def test_logged_skins_are_near_and_closed(ball: tuple[mujoco.MjModel, Path]) -> None:
    """Of the state that was logged with them: every vertex of a skin is near one of the triangles drawn for it."""
    model, folder = ball
    found = decoded(folder / "a.mcap")
    states = dict(found["/state"])
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, 0)
    weights = np.array([(i / 6, j / 6, 1 - (i + j) / 6) for i in range(7) for j in range(7 - i)])
    for now, update in found["/scene/soft"][::10]:
        data.qpos[:] = states[now]["qpos"]
        mujoco.mj_forward(model, data)
        assert [entity.id for entity in update.entities] == ["ball:left", "ball:right"]
        edges, samples = [], []
        for entity in update.entities:
            (triangles,) = entity.triangles
            assert len(triangles.points) < 700
            points = np.array([(p.x, p.y, p.z) for p in triangles.points])
            faces = np.reshape(triangles.indices, (-1, 3))
            samples.append(np.einsum("sc,fcx->fsx", weights, points[faces]).reshape(-1, 3))
            edges += [
                (bytes(points[a]), bytes(points[b])) for c in range(3) for a, b in np.roll(faces, c, axis=1)[:, :2]
            ]
        vertices = np.concatenate(skin_vertices(model, data, scene))
        assert KDTree(np.concatenate(samples)).query(vertices)[0].max() < 0.02 * 0.12
        assert sorted(edges) == sorted((b, a) for a, b in edges)  # each once in either direction: no hole, no gap


@pytest.mark.slow
def test_a_soft_bodys_film_is_again_the_same(ball: tuple[mujoco.MjModel, Path], tmp_path: Path) -> None:
    film_of(read_log(ball[1] / "a.mcap"), tmp_path / "b.mp4", size=(96, 64))
    one, other = (list(pictures_of(path)) for path in (ball[1] / "a.mp4", tmp_path / "b.mp4"))
    assert len(one) == 30
    assert all(np.array_equal(before, after) for before, after in zip(one, other, strict=True))
    assert not np.array_equal(one[0], one[-1])


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("no log, but longer than the first eight bytes")
    with pytest.raises(MjframesError, match=r"a\.mcap: not a log"):
        read_log(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").write_text("")
    with pytest.raises(MjframesError, match=r"a\.mcap: not a log"):
        read_log(tmp_path / "a.mcap")
    with pytest.raises(MjframesError, match=r"b\.mcap: the log cannot be read"):
        read_log(tmp_path / "b.mcap")


def test_what_a_scene_names_goes_along(tmp_path: Path) -> None:
    """Two meshes of one name in two folders, and one that was given as an asset."""
    for folder, size in (("one", 0.1), ("two", 0.2)):
        (tmp_path / folder).mkdir()
        trimesh.creation.box(extents=(size,) * 3).export(tmp_path / folder / "box.stl")
    content = trimesh.creation.icosphere(radius=0.3).export(file_type="stl")
    xml = """<mujoco><asset><mesh name="a" file="one/box.stl"/><mesh name="b" file="two/box.stl"/></asset><worldbody>
      <body><geom type="mesh" mesh="a"/><geom type="mesh" mesh="b"/></body></worldbody></mujoco>"""
    (tmp_path / "scene.xml").write_text(xml)
    on_disk = mujoco.MjSpec.from_file(str(tmp_path / "scene.xml"))
    given = mujoco.MjSpec.from_string(
        '<mujoco><compiler meshdir="in"/><asset><mesh name="c" file="ball.stl"/></asset>'
        '<worldbody><body><geom type="mesh" mesh="c"/></body></worldbody></mujoco>',
        assets={"in/ball.stl": content},
    )
    for spec in (on_disk, given):
        model = spec.compile()
        model.vis.map.znear = model.body_pos[1, 2] = model.opt.gravity[0] = 1 / 3  # more digits than XML has
        files = pack(spec, model)
        assert len(files) == 2 + model.nmesh
        again = unpack(files, "it")
        assert np.array_equal(again.mesh_vert, model.mesh_vert)
        assert again.vis.map.znear == np.float32(1 / 3)
        assert again.body_pos[1, 2] == again.opt.gravity[0] == 1 / 3
    with pytest.raises(MjframesError, match=r"it: the numbers of its scene are damaged"):
        unpack({**files, NUMBERS: files[NUMBERS][:-40]}, "it")
    os.remove(tmp_path / "one" / "box.stl")
    with pytest.raises(MjframesError, match=r"the scene cannot be packed \(.*box\.stl"):
        pack(on_disk)
    with pytest.raises(MjframesError, match=r"^it: MuJoCo cannot load its scene \(.*\)\.$"):
        unpack({SCENE: b"<mujoco><geom/></mujoco>"}, "it")


def edited_log(path: Path, about: dict[str, str] | None = None, message: Any = None, topic: str = "") -> Path:
    """A log of 50 ms, written anew with other facts, or with another message in place of the second of a topic."""
    from mcap.records import Channel, Message, Metadata

    record(mujoco.MjModel.from_xml_string(ROOM), 0.05, log=path, scene=mujoco.MjSpec.from_string(ROOM))
    topics: dict[int, str] = {}
    seen = 0

    def changed(one: Any) -> Any:
        nonlocal seen
        if isinstance(one, Channel):
            topics[one.id] = one.topic
        elif isinstance(one, Message) and topics[one.channel_id] == topic:
            seen += 1
            one.data = json.dumps(message(json.loads(one.data))).encode() if seen == 2 else one.data
        elif isinstance(one, Metadata):
            facts = {**one.metadata, **(about or {})}
            one.metadata = {key: value for key, value in facts.items() if value != "-"}
        return one

    path.write_bytes(rewritten(path.read_bytes(), changed))
    return path


@pytest.mark.parametrize("value", ["-", "", "much", "nan", "-1", "1e999", "0x10"])
@pytest.mark.parametrize("fact", ["timestep", "steps", "seconds", "weight"])
def test_facts_of_a_log_that_are_no_numbers_are_one_sentence(tmp_path: Path, fact: str, value: str) -> None:
    path = edited_log(tmp_path / "a.mcap", {fact: value})
    if value == "-" and fact in ("steps", "seconds"):
        assert read_log(path).recording().instants  # as of a log that was cut off
        return
    with pytest.raises(MjframesError, match=rf"a\.mcap: .*({fact}|of what)"):
        read_log(path).recording()


WRONG = [None, "x", [], {}, True, [[]], ["x"], [None], 10**400]


@pytest.mark.parametrize("topic", ["/state", "/energy", "/contacts"])
def test_each_field_of_a_log_is_refused_in_one_sentence(tmp_path: Path, topic: str) -> None:
    for key in ("time", *FIELDS[topic[1:]]):
        for value in WRONG:
            if value == [] and FIELDS[topic[1:]].get(key) is numbers.NUMBERS:
                continue  # no numbers are numbers
            path = edited_log(tmp_path / "a.mcap", message=lambda one, k=key, v=value: {**one, k: v}, topic=topic)
            with pytest.raises(MjframesError, match=rf"a\.mcap: the log is damaged \(a message of {topic} has no"):
                read_log(path)
    for value in (None, [], "x", 3):
        path = edited_log(tmp_path / "a.mcap", message=lambda _, v=value: v, topic=topic)
        with pytest.raises(MjframesError, match=r"a\.mcap: the log is damaged"):
            read_log(path)


def test_states_of_other_lengths_or_not_finite_are_refused(tmp_path: Path) -> None:
    for key in ("qpos", "qvel"):
        short = edited_log(tmp_path / "a.mcap", message=lambda one, k=key: {**one, k: one[k][:-1]}, topic="/state")
        with pytest.raises(MjframesError, match=rf"a\.mcap: its state at .* s has \d+ {key}, the first one \d+;"):
            read_log(short).states()
        nan = edited_log(
            tmp_path / "a.mcap", message=lambda one, k=key: {**one, k: [math.nan, *one[k][1:]]}, topic="/state"
        )
        log = read_log(nan)
        with pytest.raises(MjframesError, match=rf"a\.mcap: its state at .* s has {key} that are not finite;"):
            state_at(log, log.states()[1]["time"])
        assert state_at(log, log.states()[0]["time"])["qpos"]


@pytest.mark.parametrize("fact", ["timestep", "steps"])
def test_zero_steps_are_refused(tmp_path: Path, fact: str) -> None:
    with pytest.raises(
        MjframesError, match=rf"a\.mcap: the log says {fact} = '0', which is no such number; it is damaged"
    ):
        read_log(edited_log(tmp_path / "a.mcap", {fact: "0"}))


def test_deep_messages_are_refused(tmp_path: Path) -> None:
    from mcap.records import Message

    path = edited_log(tmp_path / "a.mcap")
    deep = b'{"time": ' + b"[" * 10**5
    content = rewritten(
        path.read_bytes(), lambda one: dataclasses.replace(one, data=deep) if isinstance(one, Message) else one
    )
    path.write_bytes(content)
    with pytest.raises(MjframesError, match=r"a\.mcap: the log is damaged \(maximum recursion depth"):
        read_log(path)


def test_a_state_that_is_far_away_has_no_film(tmp_path: Path) -> None:
    path = edited_log(tmp_path / "a.mcap", message=lambda one: {**one, "time": 1e300}, topic="/state")
    with pytest.raises(MjframesError, match=r"a\.mcap: its states go on to 1e\+300 s, for more than 1,000,000 frames"):
        film_of(read_log(path), tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == [path]


def test_metadata_and_topics_of_others_are_left_alone(tmp_path: Path) -> None:
    from mcap.records import Channel, Metadata

    def changed(one: Any) -> Any:
        if isinstance(one, Channel):
            one.topic = "sensors"
        return dataclasses.replace(one, name="world") if isinstance(one, Metadata) else one

    path = tmp_path / "a.mcap"
    record(mujoco.MjModel.from_xml_string(ROOM), 0.05, log=Log(path, topics=("sensors",)))
    path.write_bytes(rewritten(path.read_bytes(), changed))
    with pytest.raises(MjframesError, match="not a log that mjframes wrote"):
        read_log(path)


def test_a_packed_scene_reads_no_files_of_the_disk(tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "box.stl")
    for xml in (
        f'<mujoco><asset><mesh name="a" file="{tmp_path}/box.stl"/></asset></mujoco>',
        f'<mujoco><compiler meshdir="{tmp_path}"/><asset><mesh name="a" file="box.stl"/></asset></mujoco>',
        f'<mujoco><include file="{tmp_path}/other.xml"/></mujoco>',
    ):
        with pytest.raises(MjframesError, match=r"the log: MuJoCo cannot load its scene \(it (names|looks)"):
            unpack({SCENE: xml.encode()}, "the log")


@pytest.mark.parametrize("name", ["nq", "geom_type", "__class__.x", "opt.iterations", "vis.global_.nothing"])
def test_numbers_of_a_packed_scene_are_those_of_its_model(name: str) -> None:
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **{name: np.zeros(1)})
    with pytest.raises(MjframesError, match="the numbers of its scene are damaged"):
        unpack({SCENE: ROOM.encode(), NUMBERS: stream.getvalue()}, "the log")


def with_number(name: str, value: float) -> dict[str, bytes]:
    """The room, packed, with a number of its model set everywhere."""
    spec = mujoco.MjSpec.from_string(ROOM)
    model = spec.compile()
    owner, _, last = name.rpartition(".")
    stream, before = io.BytesIO(), np.asarray(getattr(operator.attrgetter(owner)(model) if owner else model, last))
    np.savez(stream, allow_pickle=False, **{name: np.full(before.shape, value)})
    return {**pack(spec), NUMBERS: stream.getvalue()}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("body_pos", np.nan),
        ("qpos0", np.inf),
        ("geom_rgba", -np.inf),
        ("opt.timestep", np.nan),
        ("opt.timestep", 0.0),
        ("stat.extent", 0.0),
        ("stat.extent", 1e-20),
        ("vis.map.znear", 0.0),
        ("vis.map.znear", -1.0),
        ("vis.map.zfar", 0.0),
        ("vis.global_.fovy", 0.0),
    ],
)
def test_numbers_that_nothing_can_be_drawn_with_are_refused(name: str, value: float) -> None:
    """MuJoCo ends the process for some of them, and draws nothing for others."""
    with pytest.raises(MjframesError, match=rf"^the log: .*{re.escape(name)} .*\.$"):
        unpack(with_number(name, value), "the log")


def test_a_scene_that_has_no_number_where_it_must_be_positive_is_refused() -> None:
    xml = '<mujoco><visual><map znear="nan"/></visual></mujoco>'
    with pytest.raises(MjframesError, match=r"the log: vis\.map\.znear of its scene is nan; it must be finite"):
        unpack({SCENE: xml.encode()}, "the log")


def test_infinite_numbers_that_a_scene_has_itself_are_kept() -> None:
    spec = mujoco.MjSpec.from_string('<mujoco><custom><numeric name="a" data="inf 1"/></custom></mujoco>')
    model = spec.compile()
    model.numeric_data[1] = 1 / 3
    assert unpack(pack(spec, model), "the log").numeric_data.tolist() == [np.inf, 1 / 3]


ASSET = "<mujoco><asset>{}</asset></mujoco>"
REPLICATE = '<replicate count="1000" offset="0 0 1">'
WORLD = "<mujoco><worldbody>{}</worldbody></mujoco>"


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        (ASSET.format('<texture name="a" type="2d" builtin="flat" width="60000" height="60000"/>'), "its textures"),
        (ASSET.format('<texture name="a" builtin="flat" width="9000" height="1"/>'), "its textures"),
        (
            ASSET.format('<texture name="a" type="2d" builtin="flat" width="8192" height="4097"/>' * 2),
            "its textures have 6.71e",
        ),
        (ASSET.format('<texture name="a" type="2d" builtin="flat" width="-9" height="-9"/>'), "has width='-9'"),
        (ASSET.format('<texture name="a" type="2d" file="a.png"/>'), "its textures"),
        (ASSET.format('<hfield name="a" nrow="60000" ncol="60000" size="1 1 1 1"/>'), "its height fields"),
        (ASSET.format('<mesh name="a" builtin="sphere" params="12"/>'), "a <mesh> that MuJoCo writes out"),
        (WORLD.format(f'{REPLICATE * 3}<geom size="1"/>{"</replicate>" * 3}'), "a <replicate> that MuJoCo writes out"),
        (
            WORLD.format('<body><flexcomp name="a" type="grid" count="900 900 900" mass="1"/></body>'),
            "a <flexcomp> that MuJoCo writes out",
        ),
        ('<mujoco><include file="more.xml"/></mujoco>', "a <include> that MuJoCo writes out"),
    ],
)
def test_a_scene_that_asks_for_too_much_is_refused_before_mujoco_makes_it(xml: str, words: str) -> None:
    files = {"more.xml": b"<mujoco/>"} | ({"a.png": write_png(60000, 60000)} if "a.png" in xml else {})
    with pytest.raises(MjframesError, match=rf"^the log: MuJoCo cannot load its scene \(.*{words}.*\)\.$"):
        unpack({SCENE: xml.encode(), **files}, "the log")


def write_png(width: int, height: int) -> bytes:
    """The beginning of a picture of that size."""
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + bytes(9)


BEFORE_4 = mujoco.mj_version() < 4_000_000  # has <composite>
CABLE = """<composite prefix="c" type="cable" curve="s" count="4 1 1" size="1"><joint kind="main"/>
<geom type="capsule" size=".01"/></composite>"""


def test_what_mujoco_writes_out_is_packed_written_out() -> None:
    spec = mujoco.MjSpec.from_string(
        '<mujoco><asset><mesh name="a" builtin="sphere" params="1"/></asset><worldbody>'
        '<geom type="mesh" mesh="a"/><replicate count="3" offset="0 0 1"><geom size=".1"/></replicate>'
        '<body name="d"><flexcomp name="b" type="grid" count="3 3 1" spacing=".1 .1 .1" mass="1">'
        f'<edge equality="true"/></flexcomp></body>{CABLE if BEFORE_4 else ""}</worldbody></mujoco>'
    )
    model = spec.compile()
    assert unpack(pack(spec, model), "the log").ngeom == model.ngeom == (7 if BEFORE_4 else 4)


def test_an_attachment_does_not_unpack_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write, "LARGEST_FILE", 1000)
    assert write.attached("a.xz", lzma.compress(bytes(1000))) == ("a", bytes(1000))
    for content in (lzma.compress(bytes(1001)), lzma.compress(bytes(100))[:-9]):
        with pytest.raises(lzma.LZMAError):
            write.attached("a.xz", content)
