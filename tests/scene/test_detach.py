"""A soft body is taken out of a scene, whatever it has there, and its name is free again."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, lump

from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Attached
from mjframes.scene.attach import attach
from mjframes.scene.detach import detach
from mjframes.scene.sensors import add_sensor
from mjframes.scene.solver import avoid_wrong_solver
from mjframes.scene.view import soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

TABLE = FLOOR.replace(
    "</worldbody>",
    '<body name="hand" pos="0 0 .5"><joint name="hand"/><geom size=".01"/></body><body name="arm"><geom size=".01"/>'
    "</body></worldbody>",
)


def fastened() -> SoftBody:
    """A bar whose ends move with two bodies."""
    labels = np.ones((8, 3, 3), int)
    volume = Volume.from_labels(labels, 0.01, {1: Material(1e4, 0.4, 1000, "meat")})
    ends = [np.zeros(labels.shape, bool) for _ in range(2)]
    ends[0][0], ends[1][-1] = True, True
    return build(volume, 2, supports=[Attached("hand", ends[0]), Attached("arm", ends[1])])


def without_empty(spec: mujoco.MjSpec) -> list[str]:
    """The scene's lines, but for empty default classes and frames, and for plugins that nothing uses."""
    lines = [line for line in spec.to_xml().splitlines() if line.strip()]
    unseen = ("default", "extension", "plugin plugin", "frame")
    return [line for line in lines if not line.strip().lstrip("</").startswith(unseen)]


@pytest.mark.parametrize("kind", ["lump", "fastened"])
@pytest.mark.parametrize("name", ["steak", "s"])
@pytest.mark.parametrize("deleted", [False, True])
@pytest.mark.filterwarnings("ignore::mjframes.scene.attach.BranchWarning")
def test_nothing_is_left_of_a_body(kind: str, name: str, deleted: bool) -> None:
    spec = mujoco.MjSpec.from_string(TABLE)
    avoid_wrong_solver(spec)  # what is the scene's stays
    spec.compile()
    before, body = without_empty(spec), lump() if kind == "lump" else fastened()
    for _ in range(2):  # the name is free again
        attach(spec, body, name, pos=(0, 0, 1))
        add_sensor(spec, body, name, "elastic_energy")
        assert soft_names(spec.compile()) == [name]
        mujoco.MjModel.from_xml_string(spec.to_xml())
        if deleted:
            spec.delete(spec.body(name))
        detach(spec, name)
        model = spec.compile()
        assert (model.nskin, model.nplugin, model.nnumeric, model.ntext, model.nsensor) == (0, 0, 0, 0, 0)
        assert without_empty(spec) == before
        assert deleted or not list(spec.frames)


def test_others_stay() -> None:
    spec = mujoco.MjSpec.from_string(TABLE)
    for name in ("steak", "steak2", "a"):
        attach(spec, lump(), name, pos=(0, 0, 1))
    detach(spec, "steak")
    model = spec.compile()
    assert soft_names(model) == ["steak2", "a"]
    mujoco.mj_step(model, mujoco.MjData(model))


def test_what_is_beside_it_in_a_frame_stays() -> None:
    spec = mujoco.MjSpec.from_string(TABLE)
    attach(spec, lump(), "steak")
    beside = spec.worldbody.add_site(name="beside")
    beside.set_frame(spec.body("steak").frame)
    detach(spec, "steak")
    assert spec.compile().nsite == 1


def test_a_body_that_is_not_there_is_told_of() -> None:
    spec = mujoco.MjSpec.from_string(TABLE)
    with pytest.raises(MjframesError, match="name is 'steak' but the spec's soft bodies are: none"):
        detach(spec, "steak")
    attach(spec, lump(), "lump")
    with pytest.raises(MjframesError, match="name is 'hand' but the spec's soft bodies are: 'lump'"):
        detach(spec, "hand")
    with pytest.raises(MjframesError, match="spec is a MjModel"):
        detach(spec.compile(), "lump")  # pyright: ignore[reportArgumentType]
