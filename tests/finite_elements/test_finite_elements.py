"""The multigrid solver, from a brick up to whole bodies: against the assembled matrix, solved directly."""

from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import bar
from builders.solved import BODIES, Solved, body, grid_of, rigid, solved
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.finite_elements import conjugate, kernels
from mjframes.finite_elements.batch import LoadBatch
from mjframes.finite_elements.cycle import precondition
from mjframes.finite_elements.displacements import TOLERANCE, displacements
from mjframes.finite_elements.element import CORNERS, brick_stiffness, coefficients
from mjframes.finite_elements.matrices import BlockRows, Bricks
from mjframes.finite_elements.mesh import body_mesh
from mjframes.finite_elements.motions import motions
from mjframes.finite_elements.respond import respond
from mjframes.finite_elements.solver import body_solver
from mjframes.volume.grid import Grid

EDGES = np.array([0.01, 0.013, 0.008])
POISSON = (0.0, 0.3, 0.499)
LEVELLED = ("composite 1:1e4", "two sheets", "edges and a corner", "free", "touching pieces")


# one brick


@pytest.mark.parametrize("poisson", POISSON)
def test_a_brick_resists_nothing_but_its_strain(poisson):
    matrix, place = brick_stiffness(poisson, EDGES), CORNERS * EDGES
    assert np.array_equal(matrix, matrix.T)
    values = np.linalg.eigvalsh(matrix)
    assert np.abs(values[:6]).max() < 1e-12 * values[-1] < 1e-6 * values[6]
    assert np.abs(matrix @ rigid(place)).max() < 1e-12 * np.abs(matrix).max()


@pytest.mark.parametrize("poisson", POISSON)
def test_patch_of_a_brick_has_the_energy_and_the_forces_of_its_stress(poisson):
    slope = np.random.default_rng(0).normal(size=(3, 3))
    strain = (slope + slope.T) / 2
    lam, mu = poisson / ((1 + poisson) * (1 - 2 * poisson)), 1 / (2 * (1 + poisson))
    stress = lam * np.trace(strain) * np.eye(3) + 2 * mu * strain
    force = (brick_stiffness(poisson, EDGES) @ (CORNERS * EDGES @ slope.T).ravel()).reshape(8, 3)
    areas = (2 * CORNERS - 1) * np.prod(EDGES) / EDGES / 4  # of the three faces at a corner, a quarter each, outwards
    np.testing.assert_allclose(force, areas @ stress, rtol=0, atol=1e-12 * np.abs(force).max())


@pytest.mark.parametrize("poisson", POISSON)
@pytest.mark.parametrize(("along", "across"), [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)])
def test_a_brick_bends_as_a_beam_does(poisson, along, across):
    """½ EI κ² L, with κ = 1: plain bricks are stiffer by a third and more."""
    x = (CORNERS - 0.5) * EDGES
    third = 3 - along - across
    moved = np.zeros((8, 3))
    moved[:, along] = x[:, along] * x[:, across]
    moved[:, third] = -poisson * x[:, third] * x[:, across]  # the saddle of a bent beam
    energy = moved.ravel() @ brick_stiffness(poisson, EDGES) @ moved.ravel() / 2
    inertia = EDGES[third] * EDGES[across] ** 3 / 12
    assert energy == pytest.approx(inertia * EDGES[along] / 2, rel=1e-10)


@pytest.mark.parametrize("poisson", POISSON)
def test_coefficients_are_all_of_a_brick(poisson):
    """One product of the kernel with unit displacements gives back the matrix."""
    k, matrix = 16, brick_stiffness(poisson, EDGES)
    corner, material = np.array([[0, 2, 4, 6]], np.int32), np.zeros(1, np.int32)
    brick = Bricks(corner, material, coefficients(matrix)[None], np.array([0, 1]), np.array([0, 4, 8]))
    for some in (slice(0, 12), slice(12, 24)):
        unit, product = np.zeros((24, k)), np.zeros(24 * k)
        unit[some, :12] = np.eye(12)
        brick.subtract(unit.ravel(), product, brick.scratch(k), (0,) * k)
        found = -product.reshape(24, k)[:, :12]
        np.testing.assert_allclose(found, matrix[:, some], rtol=0, atol=1e-13 * np.abs(matrix).max())


# a body's bricks


def test_bridges_join_voxels_that_touch_along_an_edge_or_at_a_corner():
    soft_and_stiff = (1e3, 0.3), (1e6, 0.3)
    labels = np.zeros((2, 2, 1), int)
    labels[0, 0], labels[1, 1] = 2, 1
    mesh = body_mesh(grid_of(labels, *soft_and_stiff), [])
    assert len(mesh.place) == 3
    assert mesh.material[mesh.voxel < 0].tolist() == [0]  # of the softer one
    corner = np.zeros((2, 2, 2), int)
    corner[0, 0, 0], corner[1, 1, 1] = 1, 2
    assert np.count_nonzero(body_mesh(grid_of(corner, *soft_and_stiff), []).voxel < 0) == 2
    corner[1, 0] = 1  # faces connect all now, but for the last
    corner[1, 1] = 0
    assert np.count_nonzero(body_mesh(grid_of(corner, *soft_and_stiff), []).voxel < 0) == 0


def test_a_node_of_two_pieces_is_the_firsts():
    grid = bar(1, 1, 1, 1)
    mesh = body_mesh(grid, [np.array([1]), np.array([0])])
    assert mesh.voxel.tolist() == [2, 3]
    assert mesh.held_by.reshape(3, 4).tolist() == [[0] * 4, [-1] * 4, [-1] * 4]


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ([[]], r"held\[0\] is empty"),
        ([[0, 1], [1, 2]], r"held\[1\] overlaps an earlier piece"),
        ([[0, 1], [2, 3, 4, 5]], "leave no voxel free"),
        ([[0, 1], [3, 4, 5]], "leave no node of the voxels free"),
    ],
)
def test_pieces_that_cannot_be_held(held, message):
    with pytest.raises(MjframesError, match=message):
        body_solver(bar(1, 1, 1, 1, 1, 1), [np.array(piece, np.int64) for piece in held])


def test_a_body_in_several_parts_is_refused():
    with pytest.raises(MjframesError, match="several parts that touch nowhere"):
        body_solver(bar(1, 0, 1))


# the levels


@pytest.mark.parametrize("name", LEVELLED)
def test_products_are_those_of_the_assembled_matrix(name):
    some, rng = body(name), np.random.default_rng(0)
    levels = some.solver.levels
    x = rng.normal(size=(3 * levels.nodes, levels.columns))
    r = rng.normal(size=x.shape)
    expected = r - some.matrix @ x / levels.unit
    found = r.astype(levels.dtype).ravel()
    batch = LoadBatch(levels)
    levels.finest.subtract(x.astype(levels.dtype).ravel(), found, batch.scratch[0], batch.lanes)
    size = abs(some.matrix) @ abs(x) / levels.unit
    assert np.all(abs(found.reshape(x.shape) - expected) < 20 * np.finfo(levels.dtype).eps * (size + abs(r)))


def interpolation(some: Solved, number: int) -> sparse.csr_array:
    """P (N, N') of a level, of one component."""
    level, coarser = some.solver.levels.above[number], some.solver.levels.above[number + 1 :]
    count = len(coarser[0].inverse) if coarser else len(some.solver.levels.last) // 3
    start, item = level.parent
    return sparse.csr_array((level.weight, item, start), shape=(len(level.inverse), count))


def matrix_of(some: Solved, number: int) -> sparse.csr_array:
    """A of a level, in the levels' unit."""
    levels = some.solver.levels
    if not number:
        return some.matrix / levels.unit
    rows = levels.above[number].matrix
    assert isinstance(rows, BlockRows)
    count = 3 * len(levels.above[number].inverse)
    value = rows.value.reshape(-1, 3, 3).astype(float)
    return sparse.csr_array(sparse.bsr_array((value, rows.column, rows.start), shape=(count, count)))


@pytest.mark.parametrize("name", LEVELLED)
def test_coarse_matrices_are_galerkins(name):
    some = body(name)
    levels = some.solver.levels
    assert levels.above
    for number in range(len(levels.above)):
        p = sparse.kron(interpolation(some, number), sparse.eye_array(3))
        expected = (p.T @ matrix_of(some, number) @ p).toarray()
        if number + 1 < len(levels.above):
            found = matrix_of(some, number + 1).toarray()
        else:  # only its inverse is kept, on which dependent nodes do not appear
            used = np.diag(levels.last) > 0
            product = levels.last[np.ix_(used, used)] @ expected[np.ix_(used, used)]
            motion = 0 if some.solver.held else 6
            values = np.linalg.eigvals(product).real
            assert np.count_nonzero(abs(values - 1) > 1e-3) <= motion
            continue
        scale = np.sqrt(np.diag(expected))
        assert np.abs((found - expected) / scale / scale[:, None]).max() < 1e-5


@pytest.mark.parametrize("name", LEVELLED)
def test_coarse_nodes_carry_rigid_motions_exactly(name):
    """Where materials differ, those of the first coarse level, as further on nodes were merged from two places."""
    some = body(name)
    free = some.solver.mesh.held_by < 0
    position = some.solver.mesh.position[free]
    linear = np.hstack([np.ones((len(position), 1)), position / position.max()])
    chain = interpolation(some, 0)[free]
    np.testing.assert_allclose(chain.sum(axis=1), 1, rtol=1e-6)
    for number in range(len(some.solver.levels.above) if len(some.grid.table) == 1 else 1):
        chain = chain @ interpolation(some, number) if number else chain
        dense = chain.toarray()
        missed = linear - dense @ np.linalg.lstsq(dense, linear, rcond=None)[0]
        assert np.abs(missed).max() < 1e-6


@pytest.mark.parametrize("name", LEVELLED)
def test_restriction_is_prolongation_transposed(name):
    levels = body(name).solver.levels
    level, rng, lanes = levels.above[0], np.random.default_rng(1), (0,) * levels.columns
    p = interpolation(body(name), 0)
    count, few = p.shape  # pyright: ignore[reportGeneralTypeIssues]  SciPy's own annotation allows None
    fine, coarse = (rng.normal(size=(some, 3 * len(lanes))).astype(levels.dtype) for some in (count, few))
    d, x, restricted = np.zeros(fine.size, levels.dtype), fine.flatten(), np.zeros(coarse.size, levels.dtype)
    kernels.prolong(*level.parent, level.weight, coarse.ravel(), d, x, lanes)
    kernels.restrict(*level.parent, level.weight, fine.ravel(), restricted, lanes)
    np.testing.assert_allclose(d.reshape(fine.shape), p @ coarse, atol=1e-5)
    np.testing.assert_allclose(x.reshape(fine.shape), fine + p @ coarse, atol=1e-5)
    np.testing.assert_allclose(restricted.reshape(coarse.shape), p.T @ fine, atol=1e-5)


@pytest.mark.parametrize("name", LEVELLED)
def test_the_preconditioner_is_symmetric_and_positive(name):
    """And never overshoots: the eigenvalues of MA are 1 at most, but for rounding."""
    some = body(name)
    levels, rng = some.solver.levels, np.random.default_rng(2)
    x = rng.normal(size=(3 * levels.nodes, levels.columns)) * some.free[:, None]
    batch = LoadBatch(levels)
    batch.r[0][:] = x.ravel()
    z = precondition(levels, batch).reshape(x.shape).astype(float)
    form = x.T @ z
    size = np.sqrt(np.diag(form))
    assert np.all(np.diag(form) > 0)
    assert np.abs((form - form.T) / size / size[:, None]).max() < 2e-5
    assert not z[~some.free].any()
    largest = np.linalg.eigvals(np.linalg.solve(form, z.T @ (some.matrix / levels.unit) @ z)).real.max()
    assert largest < 1.001


# solutions


def loads_of(some: Solved, count: int = 20) -> np.ndarray:
    """(n, 3, c) weights along the axes, pushes at places and noise; balanced on a free body."""
    rng, n = np.random.default_rng(4), len(some.grid.index)
    force = np.zeros((n, 3, count))
    force[:, range(3), range(3)] = some.grid.density[:, None] * some.grid.cell_volume
    for c in range(3, count):
        force[rng.integers(0, n, 1 + c // 3), :, c] = rng.normal(size=(1 + c // 3, 3))
    if not some.solver.held:
        motion = np.linalg.qr(rigid((some.grid.index + 0.5) * some.grid.spacing))[0]
        flat = force.reshape(3 * n, count)
        force = (flat - motion @ (motion.T @ flat)).reshape(force.shape)
        force[..., :3] = force[..., 3:6]  # its weights balance to nothing
    return force


@pytest.mark.parametrize("name", BODIES)
def test_displacements_do_the_work_of_the_exact_ones(name):
    """Conjugate gradients do too little of it, by the square of their error in the energy norm."""
    some = body(name)
    force = loads_of(some)
    flat = force.reshape(-1, force.shape[2])
    exact = some.centre @ some.solve(some.centre.T @ flat)
    found = displacements(some.solver, force).reshape(flat.shape)
    done, due = (np.einsum("dc,dc->c", flat, moved) for moved in (found, exact))
    assert np.all(done <= due * (1 + 1e-4))
    assert np.all(due - done <= 1.2 * TOLERANCE**2 * due)
    assert np.all(np.linalg.norm(found - exact, axis=0) <= 2 * TOLERANCE * np.linalg.norm(exact, axis=0))


def functions_of(some: Solved, dtype: type = float) -> sparse.csr_array:
    """(N, 7) smooth forces on the nodes: polynomials that vanish beyond a part of the body, one that is nowhere."""
    at = some.solver.mesh.position / some.solver.mesh.position.max(axis=0)
    x, y, z = at.T
    fields = [np.ones_like(x), x, (x > 0.4) * (x - 0.4), y * x, (x < 0.6) * z, x * x, 0 * x]
    return sparse.csr_array(np.stack(fields, axis=1).astype(dtype))


def whitened(exact: np.ndarray) -> np.ndarray:
    """(3m, c) combinations whose exact compliance is one, of those that move anything."""
    scale = 1 / np.sqrt(np.where(np.diag(exact) > 0, np.diag(exact), 1))
    value, vector = np.linalg.eigh(exact * scale * scale[:, None])
    kept = value > 1e-6 * value[-1]
    return scale[:, None] * vector[:, kept] / np.sqrt(value[kept])


@pytest.mark.parametrize("name", BODIES)
def test_response_to_functionals(name):
    """The compliance in its worst combination, and how each combination moves the voxels."""
    some = body(name)
    functions = functions_of(some)
    found = respond(some.solver, functions)
    force = np.kron(functions.toarray(), np.eye(3))
    balanced = np.eye(force.shape[1])
    if not some.solver.held:
        motion = rigid(some.solver.mesh.position * some.grid.spacing)
        vectors, values, _ = np.linalg.svd(force.T @ motion)
        balanced = vectors[:, np.count_nonzero(values > 1e-9 * values[0]) :]
    moved = some.solve(force @ balanced)
    exact = balanced.T @ force.T @ moved
    mix = whitened((exact + exact.T) / 2)
    values = np.linalg.eigvalsh(mix.T @ balanced.T @ found.compliance @ balanced @ mix)
    assert values[0] > 0.99
    assert values[-1] < 1.001
    assert np.array_equal(found.compliance, found.compliance.T)
    assert not found.compliance[-3:].any()
    there = found.moved.reshape(-1, force.shape[1]).astype(float) @ balanced @ mix
    wanted = some.centre @ moved @ mix
    error = np.linalg.norm(there - wanted, axis=0) / np.linalg.norm(wanted, axis=0)
    assert np.max(error) < 0.15


@pytest.mark.parametrize("name", BODIES)
def test_motions_of_held_pieces(name):
    some = body(name)
    mesh, pieces = some.solver.mesh, max(len(some.solver.held), 1)
    functions = functions_of(some)
    found = motions(some.solver, functions)
    nodes, places = mesh.position * some.grid.spacing, (some.grid.index + 0.5) * some.grid.spacing
    given = np.zeros((3 * len(nodes), 6 * pieces))
    at_voxels = np.zeros((3 * len(places), 6 * pieces))
    for i, voxels in enumerate(some.solver.held or (np.arange(len(places)),)):
        on_piece = mesh.held_by == i if some.solver.held else np.ones(len(nodes), bool)
        for points, field, rows in ((nodes, given, np.flatnonzero(on_piece)), (places, at_voxels, voxels)):
            turns = [np.cross(axis, points[rows] - found.center[i]) / found.scale for axis in np.eye(3)]
            moves = [np.tile(axis, (len(rows), 1)) for axis in np.eye(3)]
            dof = (3 * rows[:, None] + np.arange(3)).ravel()
            field[dof, 6 * i : 6 * i + 6] = np.stack([f.ravel() for f in (*moves, *turns)], axis=1)
    moved = given.copy()
    if some.solver.held:
        moved -= some.solve(some.matrix @ given)
        at_voxels += some.centre @ moved
    energy = moved.T @ some.matrix @ moved
    size = np.sqrt(np.abs(np.diag(energy)))
    assert np.linalg.eigvalsh(found.energy)[0] >= -1e-6 * np.abs(found.energy).max()
    if pieces > 1:
        assert np.abs((found.energy - energy) / size / size[:, None]).max() < 1e-3
        together = np.concatenate([np.eye(6)] * pieces)
        for i in range(pieces):
            offset = found.center[i] - found.center[0]
            together[6 * i : 6 * i + 3, 3:] = np.cross(np.eye(3), offset).T / found.scale
        along = together.T @ found.energy @ together
        assert np.abs(along).max() < 1e-6 * np.abs(found.energy).max()
    else:
        assert not found.energy.any()
    error = np.linalg.norm(found.moved.reshape(at_voxels.shape) - at_voxels, axis=0)
    assert np.max(error) < 0.01 * np.linalg.norm(at_voxels, axis=0).max()
    wanted = np.kron(functions.toarray(), np.eye(3)).T @ moved
    np.testing.assert_allclose(found.moments, wanted, rtol=0, atol=0.01 * np.abs(wanted).max())


def test_thin_and_bent_as_scikit_fems_bricks_of_second_order():
    """A plate one voxel thick, held at an end, under its own weight: plain bricks bend half as far."""
    fem = pytest.importorskip("skfem")
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    labels = np.ones((17, 4, 1), int)
    some = grid_of(labels, (1e4, 0.3))
    solver = body_solver(some, [np.flatnonzero(some.index[:, 0] < 1)])
    weight = np.zeros((len(some.index), 3, 1))
    weight[:, 2] = some.cell_volume
    ours = displacements(solver, weight, tolerance=1e-4)[:, 2, 0]
    lines = [np.arange(i, n + 1) * h for i, n, h in zip((1, 0, 0), labels.shape, some.spacing, strict=True)]
    basis = fem.Basis(fem.MeshHex.init_tensor(*lines), fem.ElementVector(fem.ElementHex2()), intorder=5)
    matrix = linear_elasticity(*lame_parameters(1e4, 0.3)).assemble(basis)
    force = fem.LinearForm(lambda v, w: v[2]).assemble(basis)
    fixed = np.flatnonzero(basis.doflocs[0] < some.spacing[0] + 1e-9)
    field = fem.solve(*fem.condense(matrix, force, D=fixed))
    moving = some.index[:, 0] > 0
    theirs = basis.probes(some.centers[moving].T) @ field
    theirs = theirs.reshape(3, -1)[2]
    assert np.linalg.norm(ours[moving] - theirs) < 0.02 * np.linalg.norm(theirs)
    assert not ours[~moving].any()


def sized(monkeypatch: pytest.MonkeyPatch, grid: Grid, held: list[np.ndarray], columns: int) -> Solved:
    """A body that is solved for so many columns at a time, as if that were all there is memory for."""
    nodes = len(body_mesh(grid, [np.flatnonzero(mask) for mask in held]).position)
    monkeypatch.setattr("mjframes.finite_elements.levels.LARGEST", columns * 6 * 3 * 4 * nodes)
    return solved(grid, *held)


@pytest.mark.slow
def test_large_bodies_are_solved_for_fewer_columns_at_a_time(monkeypatch):
    grid, held = BODIES["two pieces"]()
    usual, some = body("two pieces"), sized(monkeypatch, grid, held, 4)
    assert (usual.solver.levels.columns, some.solver.levels.columns) == (16, 4)
    force, functions = loads_of(some), functions_of(some)
    fields = [displacements(each.solver, force, tolerance=1e-3) for each in (usual, some)]
    np.testing.assert_allclose(*fields, rtol=0, atol=2e-3 * np.abs(fields[0]).max())
    found = [respond(each.solver, functions).compliance for each in (usual, some)]
    np.testing.assert_allclose(*found, rtol=0, atol=5e-3 * np.abs(found[0]).max())
    energies = [motions(each.solver, functions).energy for each in (usual, some)]
    np.testing.assert_allclose(*energies, rtol=0, atol=2e-4 * np.abs(energies[0]).max())


@pytest.mark.parametrize("name", ["composite 1:1e4", "free", "three pieces"])
def test_results_are_the_same_to_the_bit_whatever_the_threads(monkeypatch, name):
    grid, held = BODIES[name]()
    force, functions = loads_of(body(name)), functions_of(body(name))

    def results() -> list[np.ndarray]:
        solver = body_solver(grid, [np.flatnonzero(mask) for mask in held])
        response, motion = respond(solver, functions), motions(solver, functions)
        return [
            displacements(solver, force),
            response.compliance,
            response.moved,
            motion.energy,
            motion.moved,
            motion.moments,
        ]

    usual = results()
    monkeypatch.setattr("mjframes.base.threads.MOST_WORKERS", 1)
    monkeypatch.setattr("mjframes.finite_elements.batch.MEMORY", 1.0)
    for first, second in zip(usual, results(), strict=True):
        assert np.array_equal(first, second)


def test_progress_ends_at_all_batches():
    some = body("three pieces")
    calls: list[tuple[int, int]] = []

    def report(done: int, of: int) -> None:
        calls.append((done, of))

    displacements(some.solver, loads_of(some), report)
    respond(some.solver, functions_of(some), progress=report)
    assert calls == [(i + 1, of) for of in (2, 4) for i in range(of)]


def test_the_number_of_steps_does_not_depend_on_the_materials():
    """Coarse nodes do not cross from stiff to soft."""
    steps = {}
    for name in ("block", "composite 1:1e4", "composite 1:1e9"):
        some = body(name)
        levels = some.solver.levels
        batch = LoadBatch(levels)
        noise = np.random.default_rng(5).normal(size=(3 * levels.nodes, levels.columns)) * some.free[:, None]
        batch.residual[:] = noise.ravel()
        steps[name] = conjugate.solve(levels, batch, 0.01)
    assert max(steps.values()) <= 8


def test_what_is_not_solved_is_said(monkeypatch):
    monkeypatch.setattr(conjugate, "MOST_STEPS", 2)
    some = body("two sheets")
    with pytest.raises(MjframesError, match=r"is not solved: 2 steps leave an error of .* %"):
        displacements(some.solver, loads_of(some))
