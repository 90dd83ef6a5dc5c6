"""Embedded deformation of a part (Sumner 2007; §5): a graph of nodes, each with an affine map, moves the mesh.

A node j at g_j has a linear map C_j and a new position u_j. A point p becomes sum_j w_j(p) [C_j (p - g_j) + u_j],
which is linear in the unknowns x (4 rows per node: the transposed C_j, then u_j; one column per coordinate). The
energy is

    w_rot  sum_j  |A_j' A_j - 1|^2 (six distinct entries),  A_j = C_j B_j^-1
  + w_reg  sum_{j, k in N(j)}  |C_j (g_k - g_j) + u_j - u_k|^2
  + w_con  sum_c  s_c |deformed(p_c) - q_c|^2

B_j is the affine pre-alignment of the part: only what differs from it has to be a rotation: a uniform stretch is free.
All but the first term is quadratic, shares one matrix between the three coordinates and never changes for a graph.
Lengths are divided by the part's own diagonal inside the solvers: w_rot has no unit while the others scale with size^2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from shapeforge.synthesis.surfaces import farthest_points

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True)
class Weights:
    """The paper's weights of the three terms."""

    rotation: float = 3.0
    regular: float = 15.0
    constraint: float = 120.0


@dataclass(frozen=True, eq=False)
class DeformationGraph:
    """Nodes (N, 3) of a part and what never changes: its size and the normal matrix (4N, 4N) of the regular term."""

    nodes: Float[np.ndarray, "N 3"]
    size: float
    n_neighbours: int
    regular: Float[np.ndarray, "M M"] = field(repr=False)

    def basis(self, points: Float[np.ndarray, "P 3"]) -> csr_array:
        """The sparse matrix (P, 4N) that takes the unknowns x (4N, 3) to the deformed points (P, 3)."""
        index, weight = _influences(self.nodes, points, self.n_neighbours)
        offset = points[:, None] - self.nodes[index]
        values = np.concatenate([weight[..., None] * offset, weight[..., None]], axis=2)
        columns = 4 * index[..., None] + np.arange(4)
        rows = np.broadcast_to(np.arange(len(points))[:, None, None], columns.shape)
        return csr_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=(len(points), 4 * len(self.nodes)))

    def at_rest(self, matrix: Float[np.ndarray, "3 3"], offset: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "M 3"]:
        """The unknowns x that move everything by the affine map p -> matrix p + offset."""
        x = np.empty((len(self.nodes), 4, 3))
        x[:, :3] = matrix.T
        x[:, 3] = self.nodes @ matrix.T + offset
        return x.reshape(-1, 3)


def _influences(nodes: np.ndarray, points: np.ndarray, n_neighbours: int) -> tuple[np.ndarray, np.ndarray]:
    """Nearest nodes (P, n) of every point and their weights (1 - d/d_max)^2, which sum to one (Sumner's Eq. 4)."""
    n = min(n_neighbours, len(nodes))
    distance, index = cKDTree(nodes).query(points, k=min(n + 1, len(nodes)))
    distance, index = distance.reshape(len(points), -1), index.reshape(len(points), -1)
    beyond = distance[:, -1:] * (1.0 if distance.shape[1] > n else 1.25) + 1e-12
    weight = (1 - distance[:, :n] / beyond) ** 2 + 1e-12
    return index[:, :n], weight / weight.sum(axis=1, keepdims=True)


def build_graph(points: Float[np.ndarray, "P 3"], *, n_nodes: int = 100, n_neighbours: int = 20) -> DeformationGraph:
    """A graph of ``n_nodes`` of the points, spread evenly; each node's neighbours are its nearest ``n_neighbours``."""
    if len(points) == 0:
        raise ValueError("points: wanted vertices of a part, got none. Has the part lost all its faces?")
    nodes = np.asarray(points[farthest_points(points, n_nodes)], float)
    size = float(np.linalg.norm(np.ptp(nodes, axis=0))) or 1.0
    n = min(n_neighbours, len(nodes) - 1)
    regular = np.zeros((4 * len(nodes), 4 * len(nodes)))
    if n > 0:
        neighbour = cKDTree(nodes).query(nodes, k=n + 1)[1][:, 1:].ravel()
        node = np.repeat(np.arange(len(nodes)), n)
        rows = np.zeros((len(node), 4 * len(nodes)))
        edge = np.arange(len(node))
        for axis in range(3):
            rows[edge, 4 * node + axis] = nodes[neighbour, axis] - nodes[node, axis]
        rows[edge, 4 * node + 3] += 1
        rows[edge, 4 * neighbour + 3] -= 1
        regular = rows.T @ rows
    return DeformationGraph(nodes, size, n_neighbours, regular)


def pre_align(
    source: Float[np.ndarray, "C 3"], target: Float[np.ndarray, "C 3"], *, spread: float = 0.3
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Affine map (matrix (3, 3), offset (3,)) of corresponding points: q = matrix p + offset.

    Ridge regression towards the best rotation, as strong as the residual noise asks for if the matrix' entries are
    expected to differ from the rotation by ``spread``: exact where the points are, sober for thin or noisy parts.
    """
    if source.shape != target.shape or len(source) == 0:
        raise ValueError(
            f"target: wanted one position per source point, got {target.shape} for {source.shape}. "
            "Choose the template points that exist on both."
        )
    p_mean, q_mean = source.mean(axis=0), target.mean(axis=0)
    p, q = source - p_mean, target - q_mean
    second = p.T @ p / len(p)
    scale = max(np.trace(second), 1e-24)
    plain = np.linalg.lstsq(p, q, rcond=1e-6)[0]
    noise = ((q - p @ plain) ** 2).mean()
    ridge = noise / spread**2 + 1e-10 * scale
    left, _, right = np.linalg.svd(q.T @ p / len(p) + ridge * np.eye(3))
    rotation = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    matrix = np.linalg.solve(second + ridge * np.eye(3), (q.T @ p / len(p) + ridge * rotation).T).T
    if np.linalg.det(matrix) < 0.02:  # nearly flat or turned inside out: stretch along the axes only
        factor = np.sqrt(((q**2).mean(axis=0) + ridge) / ((p**2).mean(axis=0) + ridge))
        matrix = np.diag(np.clip(factor, 0.2, 5.0))
    return matrix, q_mean - matrix @ p_mean


@dataclass(frozen=True, eq=False)
class Problem:
    """One deformation to solve: a graph, constraints (rows (C, 4N), targets (C, 3), strength (C,)) and rest maps.

    ``targets`` and the unknowns are in normal coordinates; energies are in the units described in the module.
    ``normal`` (M, M) is rows' diag(strength) rows, for who knows it already.
    """

    graph: DeformationGraph
    rows: csr_array
    targets: Float[np.ndarray, "C 3"]
    strength: Float[np.ndarray, " C"]
    rest: Float[np.ndarray, "N 3 3"]
    weights: Weights = Weights()
    normal: Float[np.ndarray, "M M"] | None = None

    def __post_init__(self) -> None:
        weighted = self.rows.multiply(self.strength[:, None]).tocsr()
        scale = 1 / self.graph.size**2
        normal = (self.rows.T @ weighted).toarray() if self.normal is None else self.normal
        linear = scale * (self.weights.regular * self.graph.regular + self.weights.constraint * normal)
        object.__setattr__(self, "linear", linear)
        object.__setattr__(self, "right", scale * self.weights.constraint * (weighted.T @ self.targets))
        object.__setattr__(self, "inverse", np.linalg.inv(self.rest))
        constant = scale * self.weights.constraint * (self.strength[:, None] * self.targets**2).sum()
        object.__setattr__(self, "constant", constant)

    def stretch(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "N 3 3"]:
        """A_j = C_j B_j^-1 of every node."""
        return x.reshape(-1, 4, 3)[:, :3].transpose(0, 2, 1) @ self.inverse

    def energy(self, x: Float[np.ndarray, "M 3"]) -> float:
        """The energy of the module's formula."""
        a = self.stretch(x)
        residual = _strain(a)
        # Expanding |rows x - q|^2 would lose digits near zero, so that term is evaluated directly.
        scale = 1 / self.graph.size**2
        regular = self.weights.regular * scale * np.einsum("id,ij,jd->", x, self.graph.regular, x, optimize=True)
        miss = (self.strength[:, None] * (self.rows @ x - self.targets) ** 2).sum()
        return float(
            self.weights.rotation * (residual**2).sum() + max(regular, 0.0) + self.weights.constraint * scale * miss
        )

    def gradient(self, x: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M 3"]:
        """The exact gradient of :meth:`energy`."""
        residual, jacobian = self._rotation_terms(x)
        gradient = (2 * (self.linear @ x - self.right)).reshape(-1, 4, 3)
        gradient[:, :3] += 2 * self.weights.rotation * np.einsum("ji,jidc->jcd", residual, jacobian)
        return gradient.reshape(-1, 3)

    def _rotation_terms(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, 6) of the rotation term and their derivatives (N, 6, 3, 3) by C[d, c]."""
        a = self.stretch(x)
        jacobian = np.empty((len(a), 6, 3, 3))
        for i, (e, f) in enumerate(PAIRS):
            jacobian[:, i] = a[:, :, f, None] * self.inverse[:, None, :, e]
            jacobian[:, i] += a[:, :, e, None] * self.inverse[:, None, :, f]
        return _strain(a), jacobian


def _strain(a: np.ndarray) -> np.ndarray:
    """The six distinct entries (N, 6) of A'A - 1."""
    product = a.transpose(0, 2, 1) @ a
    return np.stack([product[:, e, f] - (e == f) for e, f in PAIRS], axis=1)


@dataclass(frozen=True, eq=False)
class SolveState:
    """One iteration of a solver: the unknowns x (4N, 3) and their energy; ``stop_reason`` is None while it goes on."""

    step: int
    x: Float[np.ndarray, "M 3"]
    energy: float
    stop_reason: str | None = None


def solve_exactly(
    problem: Problem, x: Float[np.ndarray, "M 3"], *, steps: int = 12, tolerance: float = 1e-4
) -> Iterator[SolveState]:
    """Gauss-Newton with a dense Cholesky of (9N)^2 and halved steps: the energy never rises.

    The rotation term does not know the nodes' positions: they are eliminated once for all steps.
    """
    energy = problem.energy(x)
    system = _Eliminated(problem)
    for step in range(1, steps + 1):
        move = system.solve(problem._rotation_terms(x)[1], -0.5 * problem.gradient(x))
        length = 1.0
        while length > 1e-4:
            candidate = problem.energy(x + length * move)
            if candidate <= energy:
                break
            length /= 2
        else:
            yield SolveState(step, x, energy, "no shorter step lowers the energy")
            return
        gain, x, energy = energy - candidate, x + length * move, candidate
        done = gain <= tolerance * max(energy, 1e-9)
        yield SolveState(step, x, energy, "the energy no longer falls" if done else None)
        if done:
            return


class _Eliminated:
    """The Gauss-Newton system without the nodes' positions (Schur complement), which only its constant part holds."""

    def __init__(self, problem: Problem) -> None:
        n = len(problem.graph.nodes)
        self.rotation = problem.weights.rotation
        self.u, self.c = 4 * np.arange(n) + 3, (4 * np.arange(n)[:, None] + np.arange(3)).reshape(-1)
        linear = problem.linear.copy()
        linear[np.diag_indices_from(linear)] += 1e-9 * max(np.trace(linear) / len(linear), 1e-12)
        self.cross = linear[np.ix_(self.u, self.c)]
        self.factor = cho_factor(linear[np.ix_(self.u, self.u)], lower=True, overwrite_a=True, check_finite=False)
        self.of_maps = cho_solve(self.factor, self.cross, check_finite=False)
        self.reduced = linear[np.ix_(self.c, self.c)] - self.cross.T @ self.of_maps
        # Place of C_j[d, c] in the long vector that stacks the three coordinates' maps.
        self.place = (np.arange(3)[:, None] * 3 * n + np.arange(3)).reshape(-1) + 3 * np.arange(n)[:, None]

    def solve(self, jacobian: Float[np.ndarray, "N 6 3 3"], right: Float[np.ndarray, "M 3"]) -> np.ndarray:
        """The step (M, 3) for derivatives of the rotation term and the right-hand side."""
        n, flat = len(self.u), jacobian.reshape(-1, 6, 9)
        hessian = np.zeros((9 * n, 9 * n), order="F")
        for d in range(3):
            hessian[3 * n * d : 3 * n * (d + 1), 3 * n * d : 3 * n * (d + 1)] = self.reduced
        hessian[self.place[:, :, None], self.place[:, None, :]] += self.rotation * (flat.transpose(0, 2, 1) @ flat)
        factor = cho_factor(hessian, lower=True, overwrite_a=True, check_finite=False)
        of_maps = right[self.c] - self.of_maps.T @ right[self.u]
        move = np.empty_like(right)
        maps = cho_solve(factor, of_maps.T.reshape(-1), check_finite=False).reshape(3, -1).T
        move[self.c] = maps
        move[self.u] = cho_solve(self.factor, right[self.u] - self.cross @ maps, check_finite=False)
        return move


def solve_quickly(problem: Problem, x: Float[np.ndarray, "M 3"], *, steps: int = 2) -> Iterator[SolveState]:
    """Local-global preview: nearest rotations by SVD, then one linear system factored once for all steps.

    The rotation term becomes 4 w_rot |A - R|^2, its second-order form for stretches; the energy told is that surrogate,
    which never rises.
    """
    weight = 4 * problem.weights.rotation
    matrix = problem.linear.copy()
    node = np.arange(len(problem.graph.nodes))
    place = 4 * node[:, None] + np.arange(3)
    matrix[place[:, :, None], place[:, None, :]] += weight * (problem.inverse @ problem.inverse.transpose(0, 2, 1))
    matrix[np.diag_indices_from(matrix)] += 1e-9 * np.trace(matrix) / len(matrix)
    factor = cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)
    rotation = _rotations_of_positions(problem, x)
    for step in range(1, steps + 1):
        right = problem.right.copy().reshape(-1, 4, 3)
        right[:, :3] += weight * (rotation @ problem.inverse.transpose(0, 2, 1)).transpose(0, 2, 1)
        x = cho_solve(factor, right.reshape(-1, 3), check_finite=False)
        stretch = problem.stretch(x)
        rotation = nearest_rotations(stretch)
        away = ((stretch - rotation) ** 2).sum()
        quadratic = np.einsum("id,id->", x, problem.linear @ x - 2 * problem.right) + problem.constant
        yield SolveState(step, x, float(weight * away + quadratic), "all steps done" if step == steps else None)


def _rotations_of_positions(problem: Problem, x: np.ndarray, steps: int = 6) -> np.ndarray:
    """Rotations (N, 3, 3) of the nodes if their maps were rigid: positions and rotations in turn, with N x N matrices.

    A wide bend is found in a few turns here; the full system above, where the maps resist turning, would creep to it.
    """
    n = len(problem.graph.nodes)
    u, c = 4 * np.arange(n) + 3, (4 * np.arange(n)[:, None] + np.arange(3)).reshape(-1)
    matrix = problem.linear[np.ix_(u, u)]
    matrix[np.diag_indices_from(matrix)] += 1e-9 * np.trace(matrix) / n
    factor = cho_factor(matrix, lower=True, check_finite=False)
    regular, cross = problem.graph.regular[np.ix_(c, u)], problem.linear[np.ix_(u, c)]
    rotation = nearest_rotations(problem.stretch(x))
    for _ in range(steps):
        maps = (rotation @ problem.rest).transpose(0, 2, 1).reshape(-1, 3)
        positions = cho_solve(factor, problem.right[u] - cross @ maps, check_finite=False)
        # Sum over neighbours of (u_k - u_j)(B_j (g_k - g_j))': the rotation nearest to it fits the edges best.
        edges = -(regular @ positions).reshape(n, 3, 3).transpose(0, 2, 1) @ problem.rest.transpose(0, 2, 1)
        rotation = nearest_rotations(edges)
    return rotation


def nearest_rotations(a: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 3 3"]:
    """The rotation nearest to each matrix."""
    left, _, right = np.linalg.svd(a)
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= sign[:, None]
    return left @ right


def even_strength(n_constraints: int, n_nodes: int) -> Float[np.ndarray, " C"]:
    """Weights that count as one constraint per node together, however many corresponding points there are."""
    return np.full(n_constraints, n_nodes / max(n_constraints, 1))
