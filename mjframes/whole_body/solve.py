"""TEMPORARY stand-in (direct solver) until the multigrid solver is merged."""
import itertools
from dataclasses import dataclass
import numpy as np
from scipy import sparse
COR = np.array(list(itertools.product((0, 1), repeat=3)))

def element(nu, h):
    lam, mu = nu / ((1 + nu) * (1 - 2 * nu)), 1 / (2 * (1 + nu))
    D = np.zeros((6, 6)); D[:3, :3] = lam; D[:3, :3] += 2 * mu * np.eye(3); D[3:, 3:] = mu * np.eye(3)
    g = 1 / np.sqrt(3); sg = 2 * COR - 1; nm = 11; K = np.zeros((33, 33))
    for gp in itertools.product((-g, g), repeat=3):
        dN = np.zeros((nm, 3))
        for a in range(8):
            f = 1 + sg[a] * np.array(gp)
            for d in range(3):
                t = f.copy(); t[d] = sg[a, d]; dN[a, d] = t.prod() / 8 * 2 / h[d]
        for d in range(3): dN[8 + d, d] = -2 * gp[d] * 2 / h[d]
        B = np.zeros((6, 33))
        for a in range(nm):
            x, y, z = dN[a]; B[:, 3 * a:3 * a + 3] = [[x, 0, 0], [0, y, 0], [0, 0, z], [y, x, 0], [0, z, y], [z, 0, x]]
        K += B.T @ D @ B * np.prod(h) / 8
    K = K[:24, :24] - K[:24, 24:] @ np.linalg.solve(K[24:, 24:], K[24:, :24])
    return (K + K.T) / 2

def rigid(x, c=None, scale=1.0):
    x = (x - (x.mean(0) if c is None else c)) / scale; R = np.zeros((len(x), 3, 6)); R[:, range(3), range(3)] = 1
    for a, e in enumerate(np.eye(3)): R[:, :, 3 + a] = np.cross(e, x)
    return R

@dataclass
class Response:
    compliance: np.ndarray; moved: np.ndarray; motions: np.ndarray; motion_moments: np.ndarray; motion_energy: np.ndarray

class BodySolver:
    def __init__(self, grid, held=()):
        import pypardiso
        idx = grid.index.astype(np.int64); size = idx.max(0) + 2
        ids = np.ravel_multi_index(tuple((idx[:, None] + COR).reshape(-1, 3).T), tuple(size)); u, inv = np.unique(ids, return_inverse=True)
        self.element = inv.reshape(-1, 8); self.nodes = np.stack(np.unravel_index(u, tuple(size)), 1) * grid.spacing + grid.origin @ grid.axes; self.N = len(u)
        nu = grid.per_material("poisson")[grid.material]; E = grid.young; val = np.empty((len(idx), 24, 24))
        for v in np.unique(nu): m = nu == v; val[m] = E[m, None, None] * element(v, grid.spacing)
        d = (3 * self.element[:, :, None] + np.arange(3)).reshape(-1, 24)
        self.A = sparse.csr_matrix((val.ravel(), (np.repeat(d, 24, 1).ravel(), np.tile(d, (1, 24)).ravel())), shape=(3 * self.N, 3 * self.N))
        self.C = sparse.csr_matrix((np.full(8 * len(idx), 1 / 8), (np.repeat(np.arange(len(idx)), 8), self.element.ravel())), shape=(len(idx), self.N))
        self.held = [np.unique(self.element[h]) for h in held]; mov = np.ones(self.N, bool)
        for h in self.held: mov[h] = False
        self.mov3 = np.repeat(mov, 3); self.grid = grid; self.center = self.nodes.mean(0); self.scale = np.ptp(self.nodes, axis=0).max()
        if not self.held:
            p = self.nodes - self.center; a = np.argmax((p ** 2).sum(1)); b = np.argmax(((p - p[a]) ** 2).sum(1)); c = np.argmax((np.cross(p[b] - p[a], p - p[a]) ** 2).sum(1))
            from scipy.linalg import qr
            cand = np.array([3 * i + d for i in (a, b, c) for d in range(3)])
            piv = qr(rigid(self.nodes).reshape(-1, 6)[cand].T, pivoting=True, mode="economic")[2]; self.mov3[cand[piv[:6]]] = False
        self.s = pypardiso.PyPardisoSolver(mtype=2); self.F = sparse.csr_matrix(sparse.triu(self.A[self.mov3][:, self.mov3])); self.F.sort_indices(); self.s.factorize(self.F)
    def solve(self, f):
        u = np.zeros_like(f); u[self.mov3] = np.asarray(self.s.solve(self.F, np.asfortranarray(f[self.mov3]))).reshape(-1, f.shape[1]); return u
    def voxels(self, u):
        m = u.shape[1]; return (self.C @ u.reshape(self.N, 3 * m)).reshape(-1, 3, m)

def motions(s):
    h = len(s.held)
    if h < 2: return rigid(s.nodes, s.center, s.scale).reshape(-1, 6), np.zeros((6, 6))
    out = np.zeros((3 * s.N, 6 * h))
    for i, nodes in enumerate(s.held):
        R = rigid(s.nodes, s.center, s.scale).reshape(-1, 6); d = (3 * nodes[:, None] + np.arange(3)).ravel(); out[d, 6 * i:6 * i + 6] = R[d]
    out += s.solve(-(s.A @ out)); return out, out.T @ (s.A @ out)

def respond(s, B):
    m = B.shape[1]; B3 = sparse.kron(B, sparse.identity(3), format="csr").toarray()
    if not s.held:
        R = rigid(s.nodes, s.center, s.scale).reshape(-1, 6); L = B3 - R @ np.linalg.solve(R.T @ R, R.T @ B3)
    else: L = B3
    Y = s.solve(L)
    if not s.held: Y -= R @ np.linalg.solve(R.T @ R, R.T @ Y)
    S = L.T @ Y; U, D = motions(s)
    return Response((S + S.T) / 2, s.voxels(Y).astype(np.float32), s.voxels(U), B3.T @ U, D)

def displacements(s, loads):
    """loads (n,3,k) -> (n,3,k)"""
    f = (s.C.T @ loads.reshape(len(loads), -1)).reshape(3 * s.N, -1)
    if not s.held:
        R = rigid(s.nodes, s.center, s.scale).reshape(-1, 6); f = f - R @ np.linalg.solve(R.T @ R, R.T @ f)
    return s.voxels(s.solve(f))
