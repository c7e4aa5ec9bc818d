"""The build as a whole: stages in order, what they add up to, one sentence for a mistake."""

from __future__ import annotations

import re
import warnings
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders.leaves import leaves
from builders.scenes import beam, lump
from builders.shapes import BONE, SOFT, mixed
from scipy import sparse
from threadpoolctl import threadpool_info

import mjframes as mf
from mjframes.base import cache
from mjframes.base.errors import MjframesError
from mjframes.body.build import TurnWarning, build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Attached, Fixed
from mjframes.volume.volume import Volume


@pytest.mark.usefixtures("uncached")
def test_blas_has_one_thread_in_a_build() -> None:
    """Threads of its own wait for each other where others need the processors, and change the last digits."""
    seen: set[int] = set()

    def look(_: str) -> None:
        seen.update(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")

    build(mixed(), 2, progress=look)
    assert seen == {1}


@pytest.mark.usefixtures("uncached")
def test_stages_are_reported_in_order() -> None:
    stages: list[str] = []
    build(mixed(), 2, progress=stages.append)
    assert [stage.split()[-1] for stage in stages if "%" not in stage] == [
        "voxels", "elements", "frames", "body", "weights", "surfaces",
    ]  # fmt: skip
    parts = [stage.split(": ")[1] for stage in stages if stage.startswith("condensing the whole body:")]
    assert parts[-1] == "100%"
    assert len(parts) > 1


def test_what_was_built_before_is_read_to_the_last_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And told of again, whatever the options are; another option is another body."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv(cache.SWITCH, raising=False)
    monkeypatch.setattr(cache, "WORTHWHILE", 0.0)
    some: dict[str, Any] = {
        "weights": mf.Voronoi(2),
        "supports": Attached("link", mixed().side("-x")),
        "damping": (0, 0.01),
    }
    stages: list[str] = []
    every: list[dict[str, Any]] = [{"frame_type": "point"}, {"method": mf.Paper(3), "law": "neo_hookean"}, some]
    for options in every:
        found, told = [], []
        for _ in range(2):
            stages.clear()
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                found.append(build(mixed(), progress=stages.append, **options))
            told.append([(some.category, str(some.message), some.filename) for some in caught])
        assert not stages
        assert told[0] == told[1]
        assert all(file == __file__ for _, _, file in told[0])
        assert [words for _, words, _ in told[0] if "frames" in words] or "method" in options
        same(*found)
    build(mixed(), progress=stages.append, **dict(some, damping=(0, 0.02)))
    assert stages


def same(one: Any, other: Any) -> None:
    """Assert that two values are alike, field by field, in the types of their arrays as well."""
    if is_dataclass(one):
        for some in fields(one):
            same(getattr(one, some.name), getattr(other, some.name))
    elif isinstance(one, sparse.csr_array):
        same((one.data, one.indices, one.indptr, one.shape), (other.data, other.indices, other.indptr, other.shape))
    elif isinstance(one, (tuple, list)):
        assert len(one) == len(other)
        for pair in zip(one, other, strict=True):
            same(*pair)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


@pytest.mark.parametrize("make", [lump, beam])
def test_masses_add_up_to_the_volumes(make) -> None:
    body: SoftBody = make()
    assert body.control.mass.min() > 0
    # of the lump: labels and densities of tests/shapes.py
    if make is lump:
        volume = mixed()
        voxel = np.prod(volume.spacing)
        expected = sum((volume.labels == label).sum() * m.density * voxel for label, m in volume.materials.items())
        assert body.control.mass.sum() == pytest.approx(expected)
        assert body.voxels == np.count_nonzero(volume.labels)


@pytest.mark.parametrize("make", [lump, beam])
def test_surfaces_hang_on_the_control_points(make) -> None:
    body: SoftBody = make()
    for weights, points in ((body.skin.weights, body.skin.vertices), (body.contact.weights, body.contact.positions)):
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
        np.testing.assert_allclose(weights @ body.control.rest, points, atol=1e-12)


@pytest.mark.slow
def test_the_skin_has_as_many_vertices_as_asked_for_and_touches_the_same() -> None:
    volume = Volume.sphere(0.03, SOFT, 0.0015)
    plain, coarse, fine = (build(volume, 1, skin_vertices=count) for count in (None, 400, 6000))
    assert len(coarse.skin.vertices) == pytest.approx(400, rel=0.1)
    assert len(fine.skin.vertices) == pytest.approx(6000, rel=0.1)
    assert len(plain.skin.vertices) == pytest.approx(5000, rel=0.1)
    for other in (coarse, fine):
        np.testing.assert_array_equal(other.contact.positions, plain.contact.positions)
        np.testing.assert_allclose(other.skin.weights @ other.control.rest, other.skin.vertices, atol=1e-12)


def test_frames_are_numbered_parents_first() -> None:
    for body in (lump(), beam()):
        assert body.parent[0] == -1
        assert np.all(body.parent[1:] < np.arange(1, len(body.parent)))
        assert np.all(body.parent[1:] >= 0)


def test_contact_vertices_are_sorted_by_patch_and_cluster() -> None:
    contact = lump().contact
    key = contact.patch * 100 + contact.cluster
    assert np.all(np.diff(key) >= 0)
    # sorted together with their centres and weights: see test_surfaces_hang_on_the_control_points
    assert contact.reach == pytest.approx(mixed().spacing.min() / 2)
    assert build(mixed(), 2, contact_reach=0.003).contact.reach == 0.003


def test_the_same_build_gives_the_same_bits() -> None:
    first, second = (leaves(build(mixed(), 3, seed=4)) for _ in range(2))
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_frames_can_be_placed() -> None:
    at = mixed().origin + mixed().axes @ ([3.5, 3.5, 2.5] * mixed().spacing)
    assert len(build(mixed(), at=[at]).parent) == 1


@pytest.mark.parametrize("damping", [(-1, 0), (0, -0.1), (np.nan, 0), (0, np.inf), (1,), (1, 2, 3), 3, ("much", 0)])
def test_damping_has_to_be_two_rates(damping) -> None:
    with pytest.raises(MjframesError, match=r"^damping is .* two rates"):
        build(mixed(), 2, damping=damping)


def test_damping_is_kept() -> None:
    assert build(mixed(), 2, damping=(2, 0.5)).damping == (2.0, 0.5)


def test_a_volume_in_two_pieces_is_refused() -> None:
    labels = np.ones((9, 3, 3), int)
    labels[4] = 0
    with pytest.raises(MjframesError, match="pieces"):
        build(Volume.from_labels(labels, 0.01, {1: SOFT}), 2)


def test_a_volume_may_be_a_file_and_pieces_stand_alone(tmp_path: Path) -> None:
    mixed().save(tmp_path / "v.npz")
    mask = np.zeros(mixed().labels.shape, bool)
    mask[:2] = True
    body = build(tmp_path / "v.npz", 2, supports=[Fixed(mask), Attached("arm", mask[::-1])])
    assert body.links == ("", "arm")
    assert build(tmp_path / "v.npz", 2, supports=Fixed(mask)).links == ("",)
    assert build(str(tmp_path / "v.npz"), 1).voxels == body.voxels


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "array": ({"volume": np.ones((3, 3, 3), int)}, "volume is a ndarray; give a Volume, as Volume.from_labels"),
    "file": ({"volume": "none.npz"}, "none.npz: there is no such file"),
    "seed": ({"seed": -1}, "seed is -1; it must be a whole number from 0 on"),
    "a mask alone": (
        {"supports": np.ones((16, 9, 6), bool)},
        "supports has a ndarray; give one or more pieces, as [mf.Fixed(mask)",
    ),
    "a link alone": ({"supports": ["arm"]}, "supports has a str; give one or more pieces, as [mf.Fixed("),
    "weights": ({"weights": 3}, "weights is 3; it must be one of 'voronoi', 'harmonic', 'linear', or as mf.Voronoi("),
    "method": ({"method": mf.Voronoi()}, "method is Voronoi(subdivisions=1); it must be 'whole_body', 'paper' or as"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_arguments_are_named(wrong: str) -> None:
    given, message = WRONG[wrong]
    arguments: dict[str, Any] = {"volume": mixed(), "frames": 2, **given}
    with pytest.raises(MjframesError, match=f"^{re.escape(message)}"):
        build(**arguments)


def test_a_rigid_body_needs_one_frame() -> None:
    body = build(Volume.from_labels(np.ones((3, 3, 3), int), 0.01, {1: BONE}), 1)
    assert len(body.control.mass) == 4


def test_a_body_is_shown_in_a_line() -> None:
    assert re.fullmatch(
        r"<SoftBody of 4 frames \(4 affine\), \d+ regions, \d+ voxels, .* kg; .*error: .*>", repr(lump())
    )


@pytest.mark.parametrize("method", ["whole_body", "paper"])
@pytest.mark.parametrize(("kind", "most"), [("point", 13), ("rigid", 9), ("affine", 9), ("quadratic", 5)])
@pytest.mark.filterwarnings("error", "ignore:frame_type has 'point'")
def test_more_frames_than_the_voxels_tell_apart_are_refused(kind: str, most: int, method: str) -> None:
    volume = Volume.from_labels(np.ones((3, 3, 3), int), 0.01, {1: SOFT})
    assert len(build(volume, most, frame_type=kind, method=method).types) == most
    for frames in (most + 1, 27):
        with pytest.raises(MjframesError, match=rf"has 27 voxels: too few .*; use at most {most},"):
            build(volume, frames, frame_type=kind, method=method)


@pytest.mark.filterwarnings("error")
def test_one_frame_needs_one_voxel() -> None:
    assert len(build(Volume.from_labels(np.ones((1, 1, 1), int), 0.01, {1: SOFT}), 1).types) == 1


def test_point_frames_of_a_body_that_may_tumble_are_warned_of() -> None:
    labels = np.ones((6, 3, 3), int)
    volume, end = Volume.from_labels(labels, 0.01, {1: SOFT}), np.zeros(labels.shape, bool)
    end[0] = True
    with pytest.warns(TurnWarning, match=r"'point' frames.*; use 'affine' or 'rigid' frames, or hold a piece\.$"):
        build(volume, 3, frame_type=("affine", "point", "affine"))
    with warnings.catch_warnings():
        warnings.simplefilter("error", TurnWarning)
        build(volume, 3, frame_type="point", supports=[Fixed(end)])
        build(volume, 3)
