"""Pictures: which ones there are, and that they show the numbers they claim to show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import shapes

pytest.importorskip("matplotlib")

import matplotlib
import matplotlib.image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mjframes.app.inspect import draw_pictures, field_pictures
from mjframes.app.pictures.keys import categorical
from mjframes.app.pictures.page import draw_page
from mjframes.app.pictures.slices import axis_name, bounds, directions, draw_cut
from mjframes.app.pictures.surface import draw_surface, surface_of, view_direction
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.commands import main
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


@pytest.fixture(scope="module")
def body() -> SoftBody:
    return build(shapes.mixed(), 4)


@pytest.fixture(scope="module")
def grid() -> Grid:
    return voxel_grid(shapes.mixed())


def gel(*shape: int, **rest: object) -> Volume:
    return Volume.from_labels(np.ones(shape, int), 0.01, {1: Material(1e4, 0.3, 1000)}, **rest)  # pyright: ignore[reportArgumentType]


def test_the_command_writes_every_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    build(gel(6, 4, 1), 1).save(str(tmp_path / "gel.npz"))
    assert main(["inspect", str(tmp_path / "gel.npz")]) == 0
    names = {"stiffness", "distance", "weight_0", "frames", "regions", "error"}
    folder = tmp_path / "gel-pictures"
    assert {path.name for path in folder.iterdir()} == {f"{name}.png" for name in names}
    assert f"{folder}: 6 pictures" in capsys.readouterr().out
    for path in folder.iterdir():
        image = matplotlib.image.imread(path)
        assert image.shape[:2] == (984, 1800)
        assert np.ptp(image[..., :3]) > 0.5


def test_mistakes_end_in_a_sentence(tmp_path: Path, body: SoftBody, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(tmp_path / "none.npz")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    (tmp_path / "file").write_text("")
    for folder, reason in (("file", "name a folder"), ("file/below", "cannot be written")):
        with pytest.raises(MjframesError, match=reason):
            draw_pictures(body, tmp_path / folder)


def test_fields_have_their_colours(body: SoftBody, grid: Grid) -> None:
    pictures = {picture.name: picture for picture in field_pictures(body, grid)}
    assert list(pictures) == ["stiffness", "distance", *(f"weight_{i}" for i in range(4)), "frames", "regions", "error"]

    colors = pictures["stiffness"].colors
    assert colors is not None
    viridis = matplotlib.colormaps["viridis"]
    moduli = {1: 1e3, 2: 5e3, 3: 8e4}
    for label, young in moduli.items():
        expected = viridis(np.log(young / 1e3) / np.log(8e4 / 1e3))
        np.testing.assert_allclose(colors[grid.label == label], np.tile(expected, (sum(grid.label == label), 1)))
    assert not np.any(np.all(colors[grid.label == 4] == viridis(1.0), axis=1))

    for i in range(4):
        field = body.fields.weights[:, [i]].toarray()[:, 0]
        colors, contours = pictures[f"weight_{i}"].colors, pictures[f"weight_{i}"].contours
        assert colors is not None
        assert contours is not None
        np.testing.assert_array_equal(contours[0], field)
        np.testing.assert_allclose(colors[field > 0], matplotlib.colormaps["YlGnBu"](field[field > 0]))
        assert np.ptp(colors[field == 0], axis=0).max() == 0
        assert grid.lookup[tuple(pictures[f"weight_{i}"].through)] in body.fields.seeds[i]

    distance = pictures["distance"]
    assert distance.contours is not None
    assert distance.lines is not None
    for i, seeds in enumerate(body.fields.seeds):
        np.testing.assert_array_equal(distance.contours[0][seeds], 0)
        np.testing.assert_array_equal(distance.lines[seeds], i)


def test_distance_is_in_millimetres_per_kilopascal() -> None:
    body = build(gel(11, 1, 1), at=[[0.005, 0.005, 0.005]], metric="compliance")
    picture = next(p for p in field_pictures(body, voxel_grid(body.fields.volume)) if p.name == "distance")
    assert picture.contours is not None
    np.testing.assert_allclose(picture.contours[0], np.arange(11), rtol=1e-6)  # 10 mm of 10 kPa each


def test_the_surface_shows_the_voxels_under_it() -> None:
    """Each triangle is in the colour of the voxel behind it, seen from outside and from both sides in turn."""
    body = build(gel(12, 9, 3), 1)
    grid = voxel_grid(body.fields.volume)
    surface = surface_of(grid, body.skin.vertices, body.skin.faces)
    behind = grid.centers[surface.voxel] - surface.corners.mean(axis=1)
    assert np.linalg.norm(behind, axis=1).max() < 0.01
    assert (np.sum(behind * surface.normals, axis=1) < 0).all()
    toward = view_direction(surface.corners)
    assert np.linalg.norm(toward) == pytest.approx(1)
    assert abs(toward).argmax() == 2  # the broad side
    colors = np.random.default_rng(0).random((len(grid.index), 4))
    colors[:, 3] = 1
    shown = []
    for back in (False, True):
        axes = Figure().add_subplot(projection="3d")
        draw_surface(axes, surface, colors, back)
        drawn: Any = axes.collections[0]
        seen = surface.normals @ toward * (-1 if back else 1) > 0
        painted = drawn._facecolor3d[:, :3]  # in the order given; `get_facecolor` sorts by depth
        hue = painted / np.linalg.norm(painted, axis=1)[:, None]
        wanted = colors[surface.voxel[seen], :3]
        np.testing.assert_allclose(hue, wanted / np.linalg.norm(wanted, axis=1)[:, None], atol=1e-6)  # shaded
        shown.append(seen)
    assert (shown[0] ^ shown[1]).mean() > 0.99


def test_slices_lie_where_their_scales_say() -> None:
    """A voxel drawn in a slice appears at its own coordinates, also where image axes run backwards or crosswise."""
    labels = np.ones((4, 5, 6), np.uint8)
    axes = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    volume = Volume(labels, np.array([0.01, 0.02, 0.03]), np.array([0.1, 0.2, 0.3]), axes, {1: Material(1e4, 0.3, 1e3)})
    grid = voxel_grid(volume)
    assert [axis_name(grid, a) for a in range(3)] == ["y", "z", "x"]
    turned = np.linalg.qr(np.eye(3) + 0.1 * np.arange(9).reshape(3, 3))[0]
    turned = turned * np.sign(np.linalg.det(turned))
    assert axis_name(voxel_grid(Volume(labels, volume.spacing, volume.origin, turned, volume.materials)), 0)[-1] == "′"
    chosen = 17
    colors = np.zeros((len(grid.index), 4))
    colors[chosen] = 1
    right, up = 2, 1
    figure = Figure()
    plot = figure.add_subplot()
    draw_cut(plot, grid, right, up, int(grid.index[chosen, 0]), colors, None, None)
    image = plot.images[0]
    left, far, bottom, top = image.get_extent()
    array = np.asarray(image.get_array())
    (row,), (column,) = np.nonzero(array[..., 0])
    x = left + (far - left) * (column + 0.5) / array.shape[1]
    y = bottom + (top - bottom) * (row + 0.5) / array.shape[0]
    world = 1e3 * grid.centers[chosen]
    np.testing.assert_allclose((x, y), (world[0], world[2]))
    ends = np.sort(bounds(grid), axis=0)
    np.testing.assert_allclose(ends[:, [2, 0, 1]], 1e3 * np.array([[0.1, 0.16, 0.2], [0.28, 0.2, 0.3]]))
    np.testing.assert_allclose(np.abs(directions(grid)), np.abs(axes))


@pytest.mark.parametrize("shape", [(4, 4, 4), (40, 3, 3), (3, 3, 40), (20, 1, 12), (1, 1, 1)])
def test_nothing_leaves_the_page_or_overlaps(shape: tuple[int, int, int]) -> None:
    body = build(gel(*shape), 1)
    grid = voxel_grid(body.fields.volume)
    surface = surface_of(grid, body.skin.vertices, body.skin.faces)
    picture = next(field_pictures(body, grid))
    figure = Figure(figsize=(15, 8.2))
    draw_page(figure, picture, grid, surface, "caption")
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    bars = [bar for axes in figure.axes for bar in axes.child_axes]
    boxes = [axes.get_position() for axes in [*figure.axes, *bars]]
    assert len(boxes) == 7  # two views, three slices, a key, its colour bar
    for box in boxes:
        assert min(box.x0, box.y0, 1 - box.x1, 1 - box.y1) >= 0
    drawn = [box.expanded(0.99, 0.99) for box in boxes[:6]]
    assert not any(drawn[a].overlaps(drawn[b]) for a in range(6) for b in range(a))
    (bar,) = bars
    assert bar.get_window_extent(renderer).height / figure.dpi > 1  # a bar that can be read
    everything = figure.get_tightbbox(renderer)  # with titles, scales and the legend
    assert min(everything.x0, everything.y0, 15 - everything.x1, 8.2 - everything.y1) >= 0
    sizes = []
    for axes in figure.axes[2:5]:  # all at one scale
        box = axes.get_position()
        sizes += [15 * box.width / np.diff(axes.get_xlim())[0], 8.2 * box.height / np.diff(axes.get_ylim())[0]]
    np.testing.assert_allclose(sizes, sizes[0])


def test_colours_of_numbers_differ() -> None:
    colors = categorical(60)[:, :3]
    apart = np.linalg.norm(colors[:, None] - colors, axis=2) + np.eye(60)
    assert apart.min() > 0.02
    assert min(apart[k, k + 1] for k in range(59)) > 0.25
