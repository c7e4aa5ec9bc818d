"""Pictures: which ones there are, and that they show the numbers they claim to show."""

from __future__ import annotations

from pathlib import Path

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
from mjframes.app.pictures.spectrum import natural_frequencies, region_spectra
from mjframes.app.pictures.views import Camera, cameras, glass, paint, radiograph, shoot
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
    names = {"stiffness", "distance", "weight_0", "frames", "regions", "error", "spectrum"}
    folder = tmp_path / "gel-pictures"
    assert {path.name for path in folder.iterdir()} == {f"{name}.png" for name in names}
    assert f"{folder}: 7 pictures" in capsys.readouterr().out
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
    """From above, each pixel of a block shows the voxel of the top layer at its x, y."""
    body = build(gel(12, 9, 3), 1)
    grid = voxel_grid(body.fields.volume)
    for camera in cameras(body.skin.vertices):
        frame = np.stack([camera.right, camera.up, camera.toward])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) > 0
        assert abs(camera.toward).argmax() == 2  # the broad side
        shot = shoot(camera, body.skin.vertices, body.skin.faces, grid, 120, 80)
        seen = shot.voxel >= 0
        row, column = np.nonzero(seen)
        left, right, bottom, top = shot.extent
        flat = np.stack([left + (right - left) * (column + 0.5) / 240, bottom + (top - bottom) * (row + 0.5) / 160], 1)
        offset = camera.project(grid.centers[shot.voxel[seen]]) - flat
        assert np.linalg.norm(offset, axis=1).max() < 0.02  # two voxels, at the rim
        assert np.linalg.norm(offset, axis=1).mean() < 0.008
        wanted = 2 if camera.toward[2] > 0 else 0
        facing = seen & (shot.facing > camera.toward[2] * (1 if wanted else -1) - 0.02)
        assert np.mean(grid.index[shot.voxel[facing], 2] == wanted) > 0.95
        hit = flat.max(axis=0) - flat.min(axis=0)
        size = np.ptp(camera.project(body.skin.vertices), axis=0)
        np.testing.assert_allclose(hit, size, atol=3 * (right - left) / 240)  # it fills its projection


def test_what_is_in_front_hides_what_is_behind() -> None:
    labels = np.ones((12, 9, 8), int)
    labels[:, :, 2:6] = 0
    labels[5:7, 4:6, 2:6] = 1  # two plates on a pillar
    body = build(Volume.from_labels(labels, 0.01, {1: Material(1e4, 0.3, 1000)}), 1)
    grid = voxel_grid(body.fields.volume)
    camera = Camera(*np.eye(3))
    shot = shoot(camera, body.skin.vertices, body.skin.faces, grid, 60, 40)
    layer = grid.index[shot.voxel[shot.voxel >= 0], 2]
    assert np.mean(layer == 7) > 0.9
    assert layer.min() >= 6


def test_painting_keeps_colours_and_marks_lines(body: SoftBody, grid: Grid) -> None:
    shot = shoot(cameras(body.skin.vertices)[0], body.skin.vertices, body.skin.faces, grid, 120, 80)
    plain = paint(shot, np.tile([1.0, 0.5, 0.0, 1.0], (len(grid.index), 1)))
    assert plain.shape == (80, 120, 4)
    solid = plain[..., 3] == 1
    lit = solid & (plain[..., 0] > 0.5)
    np.testing.assert_allclose(plain[lit][:, 1], 0.5 * plain[lit][:, 0], atol=0.06)  # shade keeps the hue
    assert plain[lit].max() > 0.95
    lined = paint(shot, np.ones((len(grid.index), 4)), body.fields.region)
    unlined = paint(shot, np.ones((len(grid.index), 4)))
    dark, before = (np.mean(image[solid][:, 0] < 0.5) for image in (lined, unlined))
    assert before + 0.02 < dark < 0.35
    for image in (glass(shot), radiograph(shot, grid, grid.piece >= 0, (0.2, 0.2, 0.2))):
        assert image.shape == (80, 120, 4)
        assert 0 < image[..., 3].max() <= 1
        assert image[0, 0, 3] == 0


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
    front, back = cameras(body.skin.vertices)
    shots = tuple(shoot(c, body.skin.vertices, body.skin.faces, grid, 64, 34) for c in (front, back))
    picture = next(field_pictures(body, grid))
    figure = Figure(figsize=(15, 8.2))
    draw_page(figure, picture, grid, (shots[0], shots[1]), "caption")
    boxes = [axes.get_position() for axes in figure.axes]
    assert len(boxes) == 6  # two views, three slices, one colour bar
    for box in boxes:
        assert min(box.x0, box.y0, 1 - box.x1, 1 - box.y1) >= 0
    drawn = [box.expanded(0.99, 0.99) for box in boxes]
    assert not any(drawn[a].overlaps(drawn[b]) for a in range(6) for b in range(a))
    assert max(boxes[5].width * 15, boxes[5].height * 8.2) > 1  # a bar that can be read
    everything = figure.get_tightbbox(FigureCanvasAgg(figure).get_renderer())  # with titles, scales and the legend
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


def test_spectra() -> None:
    """A free block has six motions without energy; stretched along x, two frames move on a spring EA/l."""
    body = build(gel(20, 2, 2), 2)
    for values in region_spectra(body):
        assert np.all(values > -1e-9 * values[-1])
    frequency = natural_frequencies(body)
    assert np.count_nonzero(frequency == 0) == 6
    # the slowest is bending: of a free beam ω = 22.37 √(EI/(ρA)) / l²; shear takes 2 % of it
    exact = 22.37 * np.sqrt(1e4 * 0.02**2 / 12 / 1000) / 0.2**2 / (2 * np.pi)
    assert frequency[6] == pytest.approx(exact, rel=0.03)
