"""The deformed volume of a soft body, from the lattice in the plugin's configuration: the plugin's Newton in NumPy."""

from __future__ import annotations

import mujoco
import numpy as np

from mjframes.scene.plugin_text import decode
from mjframes.scene.view import Soft


def lattice_weights(view: Soft) -> np.ndarray:
    """W (n, k) of the control points at the nodes, as the plugin has them."""
    size, point, of_node = (decode(view.configuration[key]) for key in ("set_size", "set_point", "lattice_set"))
    sets = np.split(point, np.cumsum(size)[:-1])
    weights = np.zeros((len(of_node), len(view.bodies)))
    rows = np.repeat(np.arange(len(of_node)), size[of_node])
    weights[rows, np.concatenate([sets[some] for some in of_node])] = decode(view.configuration["lattice_weight"])
    return weights / weights.sum(axis=1, keepdims=True)


class Deformed:
    """Those parts of a soft body that contact rows of the patch on MuJoCo's body `owner` can move."""

    def __init__(self, model: mujoco.MjModel, view: Soft, owner: int) -> None:
        get = {key: decode(view.configuration[f"lattice_{key}"]) for key in ("shape", "node", "distance")}
        self.spacing = float(view.configuration["lattice_spacing"])
        self.shape, self.distance = get["shape"].astype(int), get["distance"]
        self.place = np.full(self.shape.prod(), -1)
        self.place[get["node"]] = np.arange(len(get["node"]))
        path = {owner}
        while model.body_parentid[owner]:
            owner = int(model.body_parentid[owner])
            path.add(owner)
        held = np.isin(view.bodies, list(path)) | (model.body_jntnum[view.bodies] == 0)
        weights = lattice_weights(view) * held
        self.weights_of_nodes = weights / np.maximum(weights.sum(axis=1), 1e-9)[:, None]
        self.nodes = self.weights_of_nodes @ view.control_positions
        self.held = weights.sum(axis=1) > 0.5

    def _cell(self, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nodes (8,) around ξ and their shares (8,)."""
        base = np.clip(np.floor(xi).astype(int), 0, self.shape - 2)
        corner = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)])
        share = np.where(corner, xi - base, 1 - (xi - base)).prod(axis=1)
        return self.place[np.ravel_multi_index((base + corner).T, self.shape)], share

    def find(self, p: np.ndarray) -> np.ndarray:
        """ξ of the material point at p."""

        order = np.argsort(np.linalg.norm(self.nodes - p, axis=1) + np.where(self.held, 0, 1e3))
        for start in order[:200]:
            xi = np.array(np.unravel_index(np.flatnonzero(self.place == start)[0], self.shape)) + 0.5
            for _ in range(50):
                nodes, share = self._cell(xi)
                if (nodes < 0).any() or not self.held[nodes].all():
                    break
                gap = p - share @ self.nodes[nodes]
                if np.linalg.norm(gap) < 1e-13:
                    return xi
                slope = [
                    (self._cell_share(xi, a, 1) - self._cell_share(xi, a, 0)) @ self.nodes[nodes] for a in range(3)
                ]
                xi = xi + np.linalg.solve(np.array(slope).T, gap)
        raise AssertionError("no material point there")

    def _cell_share(self, xi: np.ndarray, axis: int, end: int) -> np.ndarray:
        """Shares (8,) of the nodes around ξ at the end of its cell along an axis."""
        base = np.clip(np.floor(xi).astype(int), 0, self.shape - 2)
        fraction = xi - base
        fraction[axis] = end
        corner = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)])
        return np.where(corner, fraction, 1 - fraction).prod(axis=1)

    def _slope(self, xi: np.ndarray, values: np.ndarray) -> np.ndarray:
        """∂/∂ξ (3, …) of what the nodes have as `values` (n, …)."""
        nodes, _ = self._cell(xi)
        return np.array(
            [np.tensordot(self._cell_share(xi, a, 1) - self._cell_share(xi, a, 0), values[nodes], 1) for a in range(3)]
        )

    def outward(self, p: np.ndarray) -> np.ndarray:
        """Normal (3,) of the surface above the material point at p (3,)."""
        xi = self.find(p)
        slope = np.zeros(3)
        for climb in range(4):
            nodes, share = self._cell(xi)
            slope = self._slope(xi, self.distance)
            height = share @ self.distance[nodes] / self.spacing
            if climb == 3 or abs(height) < 1e-6:
                break
            xi = xi - height * slope / np.linalg.norm(slope)
        normal = np.linalg.solve(self._slope(xi, self.nodes), slope)
        return normal / np.linalg.norm(normal)

    def weights(self, p: np.ndarray) -> np.ndarray:
        """W_j (k,) of the material point at p (3,) in the world."""
        nodes, share = self._cell(self.find(p))
        return share @ self.weights_of_nodes[nodes]


def fitted_slopes(weight: np.ndarray, x: np.ndarray) -> np.ndarray:
    """∇N_j (k, 3) of the affine motion that fits those of points x (k, 3) best, each by the size of its weight (k,)."""
    share = np.where(np.abs(weight) > 1e-9, np.abs(weight), 0)
    from_middle = x - share @ x / share.sum()
    return share[:, None] * from_middle @ np.linalg.inv(from_middle.T * share @ from_middle)
