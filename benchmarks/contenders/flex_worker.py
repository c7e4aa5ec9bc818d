"""MuJoCo's own flex, in a Python of its own: reads jobs from stdin, one JSON object a line, and answers likewise.

Runs under MuJoCo 4.0.0 or later (the elastic constants of earlier flexes were wrong) and imports nothing of mjframes.
A job's .npz has voxels (centres, E, ν, whether held, force) and a box of cells; the answers are displacements at the
voxels. Where stiffness varies, or a cell is not full, the compiled `flex_stiffness` is replaced: of cells by the exact
sum over their voxels, of tetrahedra by the mean of their voxels.
"""

from __future__ import annotations

import json
import os
import sys
import time
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from equilibrium import TIMED_STEP, release, seconds_per_step, seconds_to_rest, settle
from side_by_side import batch_rate, integration_state, mean_contacts, processor_seconds

POINTS = 3  # [a voxel and axis] Gauss's points of its stiffness
ORDER = {"full": 1, "trilinear": 1, "quadratic": 2}
KUHN = list(permutations(range(3)))  # the six tetrahedra of a cube: paths from corner to corner along the axes


class Flex:
    """One flex that has come to rest.

    contact: the flexcomp's element.  damping: Rayleigh's β [s].
    """

    contact = '<contact selfcollide="none" contype="0" conaffinity="0"/>'
    damping = 0.0

    def __init__(self, job: dict[str, np.ndarray], dof: str) -> None:
        self.job, self.dof, self.order = job, dof, ORDER[dof]
        self.low, self.cells = job["low"], job["cells"].astype(int)
        self.size = (job["high"] - job["low"]) / self.cells
        self.sample()
        start = time.perf_counter()
        self.model = self.compiled()
        self.build_seconds = time.perf_counter() - start
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.bodies = self.model.flex_vertbodyid if dof == "full" else self.model.flex_nodebodyid
        self.rest = self.places()
        self.edited = self.edit_stiffness()
        self.shapes = self.interpolation()

    def sample(self) -> None:
        """Set Gauss's points of the voxels that are not held: place, weight [m³], E, ν, cell and place in it."""
        job = self.job
        x, w = np.polynomial.legendre.leggauss(POINTS)
        offset = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3) * job["spacing"] / 2
        weight = np.einsum("a,b,c->abc", w, w, w).ravel() / 8 * np.prod(job["spacing"])
        free = np.flatnonzero(~job["held"])
        self.point = (job["centers"][free][:, None] + offset).reshape(-1, 3)
        self.weight = np.tile(weight, len(free))
        self.young, self.poisson = (np.repeat(job[name][free], len(weight)) for name in ("young", "poisson"))
        self.cell, self.place = self.locate(self.point)
        self.number = np.ravel_multi_index(tuple(self.cell.T), tuple(self.cells))
        self.full = np.bincount(self.number, self.weight, np.prod(self.cells)) / np.prod(self.size)

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the cell (s, 3) of each point, the nearest where it is outside, and its place s ∈ [0, 1]³ there."""
        at = (points - self.low) / self.size
        cell = np.clip(np.floor(at).astype(int), 0, self.cells - 1)
        return cell, at - cell

    def compiled(self, young: float | None = None, poisson: float | None = None) -> mujoco.MjModel:
        young = float(np.mean(self.young)) if young is None else young
        poisson = float(self.poisson[0]) if poisson is None else poisson
        occupied = np.argwhere(self.full.reshape(tuple(self.cells)) > 1e-6)
        corner = np.stack(np.meshgrid(*([0, 1],) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        lattice = tuple(self.cells + 1)
        used = np.unique(np.ravel_multi_index(tuple((occupied[:, None] + corner).reshape(-1, 3).T), lattice))
        number = np.full(np.prod(lattice), -1)
        number[used] = np.arange(len(used))
        points = self.low + np.stack(np.unravel_index(used, lattice), axis=1) * self.size
        tetrahedra = []
        for path in KUHN:
            corners = np.cumsum([np.zeros(3, int), *(np.eye(3, dtype=int)[list(path)])], axis=0)
            if np.linalg.det(np.diff(corners, axis=0)) < 0:
                corners = corners[[0, 2, 1, 3]]
            tetrahedra.append(occupied[:, None] + corners)
        elements = number[np.ravel_multi_index(tuple(np.concatenate(tetrahedra).reshape(-1, 3).T), lattice)]
        count = self.cells * self.order + 1
        nodes = self.low + np.stack(np.unravel_index(np.arange(np.prod(count)), tuple(count)), axis=1) * (
            self.size / self.order
        )
        pinned = np.flatnonzero(self.held(points if self.dof == "full" else nodes))
        cellcount = "" if self.dof == "full" else f'cellcount="{" ".join(map(str, self.cells))}"'
        return self.compiled_with(f"""
            <flexcomp name="flex" type="direct" dim="3" dof="{self.dof}" {cellcount} mass="{self.job["mass"]}"
                radius="{self.size.min() * 1e-3}" point="{_text(points.ravel())}" element="{_text(elements)}">
              <elasticity young="{young!r}" poisson="{poisson!r}" damping="{self.damping!r}"/>
              {self.contact}
              {f'<pin id="{_text(pinned)}"/>' if len(pinned) else ""}
            </flexcomp>""")

    def compiled_with(self, flexcomp: str) -> mujoco.MjModel:
        """Return the model of a flex alone, in which nothing touches."""
        return mujoco.MjModel.from_xml_string(f"""
            <mujoco>
              <option integrator="discrete" solver="Newton" gravity="0 0 0"><flag contact="disable"/></option>
              <size memory="1G"/>
              <worldbody>{flexcomp}</worldbody>
            </mujoco>""")

    def held(self, points: np.ndarray) -> np.ndarray:
        """Return which points are in, or on the boundary of, a voxel that is held."""
        job, reach = self.job, self.job["spacing"] * (0.5 + 1e-6)
        held = job["centers"][job["held"]]
        return np.array([np.any(np.all(np.abs(held - p) <= reach, axis=1)) for p in points])

    def places(self) -> np.ndarray:
        """Return the places (N, 3) of the nodes, of tetrahedra the vertices [m]."""
        if self.dof == "full":
            return self.data.flexvert_xpos.copy()
        return self.data.xpos[self.bodies] + self.model.flex_node

    def edit_stiffness(self) -> bool:
        """Give the flex the stiffness of the voxels; return whether that was necessary."""
        box = np.isclose(np.sum(self.weight), np.prod(self.job["high"] - self.low))
        if np.ptp(self.young) == 0 and box:
            return False
        stiffness = self.model.flex_stiffness
        if self.dof == "full":
            new = np.zeros_like(stiffness)
            count = self.model.nflexelem
            for poisson in np.unique(self.poisson):
                unit = self.compiled(1.0, float(poisson)).flex_stiffness.reshape(count, -1)
                share = self.weight * self.young * (self.poisson == poisson)
                new += (self.over_tetrahedra(share)[:, None] * unit).ravel()
            stiffness[:] = new
        else:
            stiffness[:] = -self.cell_stiffness().ravel()  # MuJoCo keeps it with the sign of the force
        return True

    def over_tetrahedra(self, share: np.ndarray) -> np.ndarray:
        """Return sums (tetrahedra,) of `share` over the points in each, by its volume."""
        occupied = np.flatnonzero(self.full > 1e-6)
        place = np.searchsorted(occupied, self.number)
        path = np.argsort(-self.place, axis=1)  # the tetrahedron 0, e_a, e_a + e_b, … holds s_a ≥ s_b ≥ s_c
        kind = np.array([KUHN.index(tuple(p)) for p in path.tolist()])
        sums = np.bincount(kind * len(occupied) + place, share, 6 * len(occupied))
        return sums / (np.prod(self.size) / 6)

    def cell_stiffness(self) -> np.ndarray:
        """Return (cells, 3a, 3a) Σ over the Gauss points of voxels: Bᵀ C B dV."""
        lam = self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))
        mu = self.young / (2 * (1 + self.poisson))
        a = (self.order + 1) ** 3
        total = np.zeros((np.prod(self.cells), 3 * a, 3 * a))
        for number in np.unique(self.number):
            some = np.flatnonzero(self.number == number)
            gradient = np.stack([self.shape(self.place[some], d) / self.size[d] for d in range(3)], axis=-1)
            both = [np.sqrt(k[some] * self.weight[some])[:, None, None] * gradient for k in (lam, mu)]
            by_lam, by_mu = ((g.reshape(len(some), -1).T @ g.reshape(len(some), -1)).reshape(a, 3, a, 3) for g in both)
            block = by_lam + by_mu.transpose(0, 3, 2, 1) + np.einsum("akbk,ij->aibj", by_mu, np.eye(3))
            total[number] = block.reshape(3 * a, 3 * a)
        return total

    def shape(self, place: np.ndarray, derivative: int | None = None) -> np.ndarray:
        """Return the shape functions (s, a) of a cell's nodes, or their derivatives along an axis of the cell."""
        nodes = np.linspace(0, 1, self.order + 1)
        parts = []
        for d in range(3):
            columns = []
            for a, node in enumerate(nodes):
                polynomial = np.poly1d(np.delete(nodes, a), r=True)
                polynomial = polynomial / polynomial(node)
                columns.append((polynomial.deriv() if d == derivative else polynomial)(place[:, d]))
            parts.append(np.stack(columns, axis=1))
        return np.einsum("sa,sb,sc->sabc", *parts).reshape(len(place), -1)

    def interpolation(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes and weights (n, a) that move each voxel's centre."""
        cell, place = self.locate(self.job["centers"])
        step = self.size / self.order
        key = np.round((self.rest - self.low) / step).astype(int)
        count = tuple(self.cells * self.order + 1)
        number = np.full(np.prod(count), -1)
        number[np.ravel_multi_index(tuple(key.T), count)] = np.arange(len(key))
        local = np.stack(np.meshgrid(*(np.arange(self.order + 1),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        if self.dof != "full":
            weight = self.shape(place)
            chosen = cell[:, None] * self.order + local
        else:
            path = np.argsort(-place, axis=1)
            sorted_place = np.take_along_axis(place, path, axis=1)
            weight = -np.diff(np.column_stack([np.ones(len(place)), sorted_place, np.zeros(len(place))]), axis=1)
            corner = np.zeros((len(place), 4, 3), int)
            for k in range(3):
                corner[:, k + 1] = corner[:, k]
                corner[np.arange(len(place)), k + 1, path[:, k]] += 1
            chosen = cell[:, None] + corner
        node = number[np.ravel_multi_index(tuple(np.moveaxis(chosen, -1, 0)), count)]
        weight = np.where((node < 0) | self.job["held"][:, None], 0.0, weight)
        return node, weight

    def field(self) -> np.ndarray:
        """Return the displacements (n, 3) of the voxels [m]."""
        node, weight = self.shapes
        return np.einsum("va,vai->vi", weight, (self.places() - self.rest)[node])

    def apply(self, load: np.ndarray) -> None:
        """Apply forces (n, 3) [N] on the voxels to the bodies of the nodes."""
        node, weight = self.shapes
        on_nodes = np.zeros((len(self.rest), 3))
        np.add.at(on_nodes, node, weight[:, :, None] * load[:, None])
        self.data.xfrc_applied[:] = 0
        moving = self.model.body_dofnum[self.bodies] > 0
        np.add.at(self.data.xfrc_applied[:, :3], self.bodies[moving], on_nodes[moving])


class Placed(Flex):
    """One flex among the other things of a scene, as a file has them."""

    def __init__(self, job: dict[str, np.ndarray], dof: str, scene: str, contact: str, damping: float) -> None:
        self.scene, self.contact, self.damping = Path(scene), contact, damping
        super().__init__(job, dof)

    def compiled_with(self, flexcomp: str) -> mujoco.MjModel:
        head, _, tail = self.scene.read_text(encoding="utf-8").rpartition("</worldbody>")
        option = '<option integrator="discrete" solver="Newton"/><size memory="1G"/>'
        path = self.scene.with_name("with_flex.xml")
        path.write_text(
            f"{head}{flexcomp}</worldbody>{tail.replace('</mujoco>', option + '</mujoco>')}", encoding="utf-8"
        )
        return mujoco.MjModel.from_xml_path(str(path))

    def start(self, joints: dict[str, float], turn: np.ndarray, position: np.ndarray) -> None:
        """Put the flex, undeformed, at a pose of its coordinates, and joints of the scene at their angles."""
        mujoco.mj_resetData(self.model, self.data)
        for name, angle in joints.items():
            self.data.qpos[self.model.joint(name).qposadr[0]] = angle
        moved = self.rest @ turn.T + position - self.rest
        moving = self.model.body_jntnum[self.bodies] > 0  # not so nodes of cells without voxels
        first = self.model.jnt_qposadr[self.model.body_jntadr[self.bodies[moving]]]
        self.data.qpos[first[:, None] + np.arange(3)] = moved[moving]
        mujoco.mj_forward(self.model, self.data)

    def act(self, controls: np.ndarray, steps: int) -> float:
        """Return the processor time [s] of so many steps with each of the controls (n, nu)."""
        before = time.process_time()
        for control in controls:
            self.data.ctrl[:] = control
            mujoco.mj_step(self.model, self.data, nstep=steps)
        return time.process_time() - before


class Scene:
    """A scene with flexes, from a state shortly after first contact on, with the faster of MuJoCo's two solvers."""

    def __init__(self, xml: str, fall: int, steps: int) -> None:
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_step(self.model, self.data, nstep=fall)
        self.state = integration_state(self.model, self.data)
        seconds = {}
        for solver in (mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtSolver.mjSOL_CG):
            self.model.opt.solver = solver
            seconds[solver] = min(self.seconds(steps) for _ in range(2))
        self.model.opt.solver = min(seconds, key=lambda solver: seconds[solver])

    def seconds(self, steps: int) -> float:
        """Return the processor time of so many steps [s]."""
        return processor_seconds(self.model, self.data, self.state, steps)

    def contacts(self, steps: int) -> tuple[float, float]:
        """Return the mean numbers of contacts and of the solver's iterations."""
        return mean_contacts(self.model, self.data, self.state, steps)


def _text(numbers: np.ndarray) -> str:
    return " ".join(map(repr, np.asarray(numbers).tolist()))


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what MuJoCo prints is no answer
    flexes: dict[int, Any] = {}
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = respond(order, flexes)
        except Exception as error:  # the other side says what failed, and goes on
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def respond(order: dict[str, Any], flexes: dict[int, Any]) -> dict[str, Any]:
    match order["do"]:
        case "version":
            return {"version": mujoco.__version__}
        case "solve":
            with np.load(order["job"]) as file:
                job = {name: file[name] for name in file.files}
            flex = Flex(job, order["dof"])
            result = settle(flex.model, flex.data, partial(flex.apply, job["load"]), flex.field)
            if not result:
                return {"error": "it does not come to rest"}
            np.save(order["result"], result.pop("moved"))
            flexes[order["id"]] = flex
            return result | {"dofs": flex.model.nv, "build_seconds": flex.build_seconds, "edited": flex.edited}
        case "place":
            with np.load(order["job"]) as file:
                job = {name: file[name] for name in file.files}
            flex = Placed(job, order["dof"], order["scene"], order["contact"], order["damping"])
            flexes[order["id"]] = flex
            return {"dofs": flex.model.nv, "edited": flex.edited}
        case "act":
            flex = flexes[order["id"]]
            flex.start(order["joints"], np.array(order["turn"]), np.array(order["position"]))
            seconds = flex.act(np.array(order["controls"]), order["steps"])
            warned = {mujoco.mjtWarning(i).name: int(w.number) for i, w in enumerate(flex.data.warning) if w.number}
            return {"seconds": seconds, "warned": warned}
        case "step":
            flex = flexes[order["id"]]
            return {"seconds": seconds_per_step(flex.model, flex.data, order["timestep"], order["least"])}
        case "rest":
            flex = flexes[order["id"]]
            push = partial(flex.apply, flex.job["load"])
            return {"seconds": seconds_to_rest(flex.model, flex.data, push, order["steps"], order["timestep"])}
        case "worlds":
            flex = flexes[order["id"]]
            flex.model.opt.timestep = TIMED_STEP
            mujoco.mj_resetData(flex.model, flex.data)
            mujoco.mj_forward(flex.model, flex.data)
            flex.apply(flex.job["load"])
            start = integration_state(flex.model, flex.data)
            wall, processor = batch_rate(flex.model, start, order["worlds"], order["threads"], order["least"])
            return {"wall": wall, "processor": processor}
        case "release":
            flex = flexes[order["id"]]
            quantity = lambda: float(np.sum(flex.job["goal"] * flex.field()))  # noqa: E731
            history = release(flex.model, flex.data, quantity, order["timestep"], order["steps"])
            return {"history": history.tolist()}
        case "scene":
            flexes[order["id"]] = scene = Scene(order["xml"], order["fall"], order["steps"])
            contacts, iterations = scene.contacts(order["steps"])
            return {"dofs": scene.model.nv, "contacts": contacts, "iterations": iterations}
        case "steps":
            return {"seconds": flexes[order["id"]].seconds(order["steps"])}
        case "forget":
            flexes.clear()
            return {}
    raise ValueError(f"unknown order {order['do']!r}")


if __name__ == "__main__":
    main()
