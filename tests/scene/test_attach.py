"""Soft bodies as MJCF: names, saved scenes, contact left out, and what the plugin refuses to run."""

from __future__ import annotations

import ctypes
import re
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.damaged import DAMAGED, PRINTABLE, edited, saved, saved_beam, wrong_arrays
from builders.scenes import FLOOR, TILTED, beam, compiled, lump
from builders.shapes import mixed
from builders.tiers import thinned

from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.frames.supports import Attached
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.load import load_scene
from mjframes.scene.plugin import NAME
from mjframes.scene.plugin_text import ATTRIBUTES, decode, encode
from mjframes.scene.sensors import add_sensor
from mjframes.scene.view import soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


def scene_of_two() -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(FLOOR)
    contact = Contact(solref=None)
    attach(spec, beam(beta=0.001), "soft0", pos=(0, 0, 0.1), quat=PRINTABLE, contact=contact)
    attach(spec, lump(), "soft1", pos=(0.3, 0, 0.1), contact=contact)  # differs in the last letter only
    return spec


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    fields = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in fields.items() if isinstance(value, np.ndarray)}


def test_a_saved_scene_is_the_same_model(tmp_path: Path) -> None:
    spec = scene_of_two()
    model = spec.compile()
    path = tmp_path / "scene.xml"
    path.write_text(spec.to_xml())
    saved = mujoco.MjModel.from_xml_path(str(path))
    original = arrays(model)
    assert len(original) > 300
    for name, values in arrays(saved).items():
        if "oct" in name:  # of the patches' bounds, not used; MuJoCo does not save how deep it may be
            continue
        if name.startswith("skin_"):  # only drawn
            np.testing.assert_allclose(values, original[name], atol=1e-5, err_msg=name)
        else:
            np.testing.assert_array_equal(values, original[name], name)
    assert saved.names == model.names


def test_a_saved_scene_steps_to_the_same_bits() -> None:
    spec = scene_of_two()
    model = spec.compile()
    saved = mujoco.MjModel.from_xml_string(spec.to_xml())
    data, again = mujoco.MjData(model), mujoco.MjData(saved)
    for _ in range(200):
        mujoco.mj_step(model, data)
        mujoco.mj_step(saved, again)
    assert data.ncon > 5
    np.testing.assert_array_equal(again.qpos, data.qpos)
    np.testing.assert_array_equal(again.qvel, data.qvel)


def test_a_saved_scene_can_be_attached_with_a_prefix() -> None:
    outer = mujoco.MjSpec.from_string(FLOOR)
    inner = mujoco.MjSpec.from_string(saved_beam())
    outer.worldbody.add_frame().attach_body(inner.body("soft0"), "left_", "")
    model = outer.compile()
    attached = soft(model, mujoco.MjData(model), "left_soft0")
    direct = soft(*compiled(FLOOR, (beam(beta=0.001), (0, 0, 0.1), PRINTABLE), contact=Contact(dents=True)), "soft0")
    contacts = 0
    for _ in range(150):
        for view in (attached, direct):
            mujoco.mj_step(view.model, view.data)
            contacts += view.data.ncon
    assert contacts > 10
    np.testing.assert_array_equal(attached.control_positions, direct.control_positions)


def test_everything_is_named_after_the_body() -> None:
    spec = mujoco.MjSpec()
    attach(spec, lump(), "my_Soft-body.2")
    model = spec.compile()
    assert model.body(1).name == "my_Soft-body.2"
    names = {name for name in model.names.decode().split("\0")[1:] if name} - {"world", "MuJoCo Model"}
    assert all(name.startswith("my_Soft-body.2") for name in names)
    assert not any("/" in name for name in names)
    assert {"my_Soft-body.2:3", "my_Soft-body.2:3_y", "my_Soft-body.2:patch_0"} <= names
    assert soft_names(model) == ["my_Soft-body.2"]


@pytest.mark.parametrize("name", ["", "a b", "arm/soft", "soft:1", "söft", "soft\n", 7, None], ids=repr)
def test_bad_names_are_refused(name: Any) -> None:
    with pytest.raises(MjframesError, match=r"^name is .*; use one or more letters, digits"):
        attach(mujoco.MjSpec(), lump(), name)


def test_names_are_free(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    names = ["soft", "soft_1", "soft_1_x", "soft_patch_0", "soft_bounds", "soft_default", "soft_2", "x", "y", "x_0"]
    spec = mujoco.MjSpec.from_string(FLOOR)
    for place, name in enumerate(names):
        attach(spec, lump(), name, pos=(0.3 * place, 0, 0.1))
    add_sensor(spec, lump(), "x", "elastic_energy")
    model = spec.compile()
    for again in (model, mujoco.MjModel.from_xml_string(spec.to_xml())):
        data = mujoco.MjData(again)
        mujoco.mj_step(again, data)
        assert soft_names(again) == names
        assert again.body("x").id >= 0
        for name in names:
            assert len(soft(again, data, name).control_positions) == len(lump().control.mass)
        assert data.sensor("x_elastic_energy").data == pytest.approx(soft(again, data, "x").elastic_energy)
    assert not recwarn.list


@pytest.mark.parametrize("name", ["x", "so"])
def test_bodies_with_short_names_are_held_by_others(name: str) -> None:
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="arm"><joint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    mask = np.zeros(mixed().labels.shape, bool)
    mask[:2] = True
    attach(spec, build(mixed(), 2, supports=[Attached("arm", mask)]), name)
    model = spec.compile()
    mujoco.mj_step(model, mujoco.MjData(model))
    assert soft_names(model) == [name]
    assert all(skin.startswith(f"{name}:") for skin in (model.skin(s).name for s in range(model.nskin)))


def test_a_name_that_is_taken_is_refused() -> None:
    spec = mujoco.MjSpec()
    attach(spec, lump(), "soft")
    with pytest.raises(MjframesError, match=r"^name is 'soft', which a body of the scene has already"):
        attach(spec, lump(), "soft")


@pytest.mark.parametrize(
    ("pos", "quat"),
    [((0, 0), TILTED), ((0, 0, np.nan), TILTED), ((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (0, 0, 0, 0))],
)
def test_bad_places_are_refused(pos, quat) -> None:
    with pytest.raises(MjframesError, match="give three metres and four quaternion components, of which not all are 0"):
        attach(mujoco.MjSpec(), lump(), "soft", pos=pos, quat=quat)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "contact": ({"contact": "yes"}, "contact is 'yes'; give True, False or a Contact"),
    "parent": ({"parent": mujoco.MjSpec()}, "parent is a MjSpec; give a body of the scene, or its name"),
    "name": ({"parent": "arm"}, "parent is 'arm', but the bodies of the scene are: 'world'."),
    "other": (
        {"parent": mujoco.MjSpec().worldbody},
        "parent is the body 'world' of another scene; give one of the spec's",
    ),
    "body": ({"body": mixed()}, "body is a Volume; give the SoftBody that build"),
    "model": ({"spec": "scene.xml"}, "spec is a str; give the scene as an MjSpec, as MjSpec.from_file(path)"),
    "pos": ({"pos": "here"}, "pos is 'here'"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_arguments_of_other_types_are_refused(wrong: str) -> None:
    given, message = WRONG[wrong]
    arguments: dict[str, Any] = {"spec": mujoco.MjSpec(), "body": lump(), "name": "soft", **given}
    with pytest.raises(MjframesError, match=f"^{re.escape(message)}"):
        attach(**arguments)


@pytest.mark.parametrize("option", ["settotalmass", "boundmass", "boundinertia"])
def test_scenes_that_change_masses_are_refused_by_the_option(option: str, tmp_path: Path) -> None:
    xml = f'<mujoco><compiler {option}="0.5"/><worldbody/></mujoco>'
    with pytest.raises(
        MjframesError, match=rf'its <compiler {option}="0\.5"/> would change the masses .*; take it out'
    ):
        attach(mujoco.MjSpec.from_string(xml), lump(), "soft")
    (tmp_path / "scene.xml").write_text(saved_beam().replace("<compiler", f'<compiler {option}="0.5"', 1))
    with pytest.raises(MjframesError, match=rf'scene.xml: .*its <compiler {option}="0\.5"/>'):
        load_scene(tmp_path / "scene.xml")


def test_the_volume_stands_where_it_was_put() -> None:
    pos, quat = np.array([0.1, -0.2, 0.3]), np.array(TILTED) * 2
    model, data = compiled("<mujoco/>", (lump(), tuple(pos), tuple(quat)))
    mujoco.mj_forward(model, data)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quat / np.linalg.norm(quat))
    view = soft(model, data, "soft0")
    expected = pos + lump().control.rest @ turn.reshape(3, 3).T
    np.testing.assert_allclose(view.control_positions, expected, atol=1e-6)
    np.testing.assert_array_equal(data.qpos, 0)
    assert model.body_mass.sum() == pytest.approx(lump().control.mass.sum(), rel=1e-5)


def test_without_contact_there_are_no_patches() -> None:
    model, data = compiled(FLOOR, (lump(), (0, 0, -0.5), TILTED), contact=False)
    assert [model.geom(i).name for i in range(model.ngeom)] == ["floor"]
    assert model.nmesh == 0
    assert not [key for key in soft(model, data, "soft0").configuration if key.startswith(("patch_", "contact_"))]
    mujoco.mj_step(model, data)
    assert data.ncon == 0


def test_a_saved_scene_is_loaded_without_large_octrees() -> None:
    """MuJoCo makes one of each patch's mesh: a cube in the place of the mesh has 63,000 cells, in 0.3 s."""
    spec = mujoco.MjSpec()
    attach(spec, beam(), "soft0")
    model = spec.compile()
    saved = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert saved.nmesh > 1
    assert saved.noct < 6000 * saved.nmesh
    patches = model.geom_type == mujoco.mjtGeom.mjGEOM_SDF
    for one in (model, saved):
        assert (one.geom_aabb[patches, 3:] == one.geom_aabb[patches, 3:4]).all()  # cubes around the carriers
    np.testing.assert_array_equal(saved.geom_aabb, model.geom_aabb)


def test_labels_of_one_material_have_skins_of_their_own() -> None:
    labels = np.repeat([1, 2, 3, 4], 3)[:, None, None] * np.ones((1, 3, 3), int)
    bone, none = Material.rigid(1900, name="bone"), Material(1e4, 0.4, 1000)
    fat = Material(1e4, 0.4, 920, name="fat")
    model, _ = compiled(
        FLOOR,
        (build(Volume.from_labels(labels, 0.01, {1: bone, 2: bone, 3: none, 4: fat}), 2), (0, 0, 1), (1, 0, 0, 0)),
    )
    assert [model.skin(s).name for s in range(4)] == ["soft0:bone_1", "soft0:bone_2", "soft0:3", "soft0:fat"]


def test_skins_move_with_the_control_points() -> None:
    model, data = compiled("<mujoco/>", (lump(), (0.1, 0, 0), TILTED))
    assert model.nskin == len(lump().materials)
    data.qpos[:] = 0.01 * np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 100)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, scene)
    x = soft(model, data, "soft0").control_positions
    body = lump()
    for skin in range(model.nskin):
        label = np.unique(body.skin.label)[skin]
        used = np.unique(body.skin.faces[body.skin.label == label])
        start, count = model.skin_vertadr[skin], model.skin_vertnum[skin]
        drawn = scene.skinvert.reshape(-1, 3)[start : start + count]
        np.testing.assert_allclose(drawn, body.skin.weights[used] @ x, atol=2e-5)
        np.testing.assert_allclose(model.skin_rgba[skin], body.materials[int(label)].rgba, atol=1e-6)


def test_skin_weights_have_few_digits_and_sum_to_1() -> None:
    model, _ = compiled("<mujoco/>", (lump(), (0.1, 0, 0), TILTED))
    exact = lump().skin.weights.toarray()
    for skin, label in enumerate(np.unique(lump().skin.label)):
        used = np.unique(lump().skin.faces[lump().skin.label == label])
        written = np.zeros((len(used), len(lump().control.frame)))
        for bone in model.skin_boneadr[skin] + np.arange(model.skin_bonenum[skin]):
            start, count = model.skin_bonevertadr[bone], model.skin_bonevertnum[bone]
            point = int(model.body(model.skin_bonebodyid[bone]).name.rpartition(":")[2])
            written[model.skin_bonevertid[start : start + count], point] = model.skin_bonevertweight[start:][:count]
        np.testing.assert_allclose(written, np.round(written, 4), atol=1e-6)
        np.testing.assert_allclose(written.sum(axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(written, exact[used], rtol=0, atol=1.01e-4)


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        (np.array([0.1, -1e300, np.pi]), "f64"),
        (np.array([0.1, -3e38, np.pi], np.float32), "f32"),
        (np.array([127, -128]), "i8"),
        (np.array([128, -32768]), "i16"),
        (np.array([7, -1, 2**31 - 1]), "i32"),
        (np.zeros(0), "f64"),
        (np.zeros(0, int), "i8"),
    ],
)
def test_arrays_are_decoded_to_the_bit(values: np.ndarray, kind: str) -> None:
    assert encode(values).startswith(f"{kind}:{values.size}:")
    np.testing.assert_array_equal(decode(encode(values)), values)
    assert decode(encode(values)).dtype == (np.int32 if kind[0] == "i" else np.float64)


class PluginHead(ctypes.Structure):
    """The first members of MuJoCo's mjpPlugin."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("nattribute", ctypes.c_int),
        ("attributes", ctypes.POINTER(ctypes.c_char_p)),
    )


def test_attributes_are_the_plugins_in_its_order() -> None:
    package = Path(mujoco.HEADERS_DIR).parent.parent
    library = ctypes.CDLL(str(package / f"libmujoco.so.{mujoco.mj_versionString()}"))
    library.mjp_getPlugin.restype = ctypes.POINTER(PluginHead)
    head = library.mjp_getPlugin(NAME.encode(), ctypes.byref(ctypes.c_int())).contents
    assert tuple(head.attributes[i].decode() for i in range(head.nattribute)) == ATTRIBUTES


FORBIDDEN = {
    "RK4": ("integrator", mujoco.mjtIntegrator.mjINT_RK4),
    "PGS": ("solver", mujoco.mjtSolver.mjSOL_PGS),
    "noslip": ("noslip_iterations", 1),
    "dampers": ("disableflags", mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER),
}


@pytest.mark.parametrize("option", FORBIDDEN)
def test_options_that_cannot_work_are_refused(option: str, warnings: list[str]) -> None:
    model, _ = compiled(FLOOR, (beam(), (0, 0, 1), TILTED))
    key, value = FORBIDDEN[option]
    setattr(model.opt, key, value)
    with pytest.raises(mujoco.FatalError, match="init failed"):
        mujoco.MjData(model)
    (sentence,) = warnings
    assert re.match(rf"mjframes: soft body 'soft0': .*{option} .*: (use|set) .*\.$", sentence)


@pytest.mark.parametrize("option", FORBIDDEN)
def test_options_that_are_made_wrong_later_are_told_once(option: str, warnings: list[str]) -> None:
    model, data = compiled(FLOOR, (beam(), (0, 0, 1), TILTED), (beam(), (0, 1, 1), TILTED))
    mujoco.mj_step(model, data)
    assert not warnings
    key, value = FORBIDDEN[option]
    setattr(model.opt, key, value)
    for _ in range(3):
        mujoco.mj_step(model, data)
    (sentence,) = warnings
    assert re.match(rf"mjframes: soft body 'soft0': .*{option} .*: (use|set) .*\.$", sentence)


@pytest.mark.parametrize("flag", [mujoco.mjtDisableBit.mjDSBL_SPRING, mujoco.mjtDisableBit.mjDSBL_DAMPER])
def test_without_springs_or_without_dampers_elasticity_acts(flag: int, warnings: list[str]) -> None:
    model, data = compiled(FLOOR, (beam(), (0, 0, 1), TILTED))
    data.qpos[2] += 0.01
    mujoco.mj_forward(model, data)
    expected = data.qfrc_passive.copy()
    model.opt.disableflags = flag
    mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.qfrc_passive, expected)
    assert np.abs(expected).max() > 0
    assert not warnings


def test_the_discrete_integrator_allows_pgs_and_noslip() -> None:
    model, _ = compiled(FLOOR, (beam(), (0, 0, 1), TILTED))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    model.opt.solver, model.opt.noslip_iterations = mujoco.mjtSolver.mjSOL_PGS, 3
    mujoco.mj_step(model, mujoco.MjData(model))


@pytest.mark.parametrize("damage", thinned(product(DAMAGED), 3))
def test_damaged_data_is_refused_by_a_sentence(damage: str, warnings: list[str]) -> None:
    *edit, sentence = DAMAGED[damage]
    xml = edited(*edit)
    assert xml != saved_beam()
    with pytest.raises(ValueError, match="init failed") as refusal:
        mujoco.MjModel.from_xml_string(xml)
    # MuJoCo hands on the warning in its error
    assert re.search(rf"^mjframes: soft body 'soft0': (.* )?{re.escape(sentence)}.*\.$", str(refusal.value), re.M)


def refusal(xml: str) -> str:
    """What is said of a scene that is not loaded, else ""."""
    try:
        mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("law", "method"),
    [
        ("neo_hookean", "whole_body"),
        pytest.param("corotational", "whole_body", marks=pytest.mark.slow),
        pytest.param("neo_hookean", "paper", marks=pytest.mark.slow),
    ],
)
def test_arrays_are_whole_and_finite(law: str, method: str, warnings: list[str]) -> None:
    labels = np.ones((16, 4, 4), int)
    labels[8:] = 2
    volume = Volume.from_labels(labels, 0.01, {1: Material(2e4, 0.3, 1000), 2: Material(1e5, 0.4, 1000)})
    wrong = dict(wrong_arrays(saved(build(volume, 3, law=law, method=method))))
    assert len(wrong) > 70
    assert [name for name, xml in wrong.items() if "mjframes: soft body 'soft0': " not in refusal(xml)] == []


def test_a_part_of_a_soft_body_is_refused(warnings: list[str]) -> None:
    xml = saved_beam().replace('<plugin instance="soft0"/>', "", 1)
    with pytest.raises(ValueError, match="its bodies do not match its control points: attach or copy"):
        mujoco.MjModel.from_xml_string(xml)


def test_other_joints_are_refused(warnings: list[str]) -> None:
    xml = saved_beam().replace('type="slide" axis="0 1 0"', 'type="hinge" axis="0 1 0"', 1)
    with pytest.raises(ValueError, match="each of its bodies has to have slide joints along x, y, z"):
        mujoco.MjModel.from_xml_string(xml)


@pytest.mark.parametrize("contact", [True, False])
def test_a_body_too_small_for_mujoco_is_refused(contact: bool) -> None:
    rubber = Material(1e5, 0.4, 1000)
    tiny, small = (build(Volume.box(size, rubber, spacing=size / 6), frames=2) for size in (1e-5, 1e-4))
    spec = mujoco.MjSpec()
    with pytest.raises(
        MjframesError, match=r"^dot: its control points span [0-9.]+ µm, too little for MuJoCo's masses"
    ):
        attach(spec, tiny, "dot", contact=contact)
    attach(spec, small, "dot", contact=contact)
    spec.compile()
