"""Random grasps of a ball, and the wrench programs written in cvxpy, to compare with."""

import numpy as np

from xdex_drake.contact import GraspMap, contact_frames, grasp_matrix

RADIUS, MU = 0.04, 0.6


def ball_grasp(rng, n):
    """n contacts anywhere on a ball of 4 cm: some of these grasps close and some do not."""
    outward = rng.normal(size=(n, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return RADIUS * outward, -outward


def ring_grasp(n, radius=RADIUS):
    """n contacts around the equator of a ball, evenly."""
    angle = 2.0 * np.pi * np.arange(n) / n
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    return radius * outward, -outward


def matrix(p, normals, center=(0.0, 0.0, 0.0)):
    return grasp_matrix(p, contact_frames(normals), center)


def grasp_map(p, normals, center=(0.0, 0.0, 0.0), mu=MU, length=RADIUS):
    return GraspMap(matrix(p, normals, center), mu, length)


def scaled(G, length):
    return np.concatenate([G[:3] / length, G[3:]])


def cones(cvxpy, f, mu, n, min_normal=0.0):
    result = [cvxpy.norm(f[3 * i : 3 * i + 2]) <= mu * f[3 * i + 2] for i in range(n)]
    return result + [f[3 * i + 2] >= min_normal for i in range(n)]


def balance_reference(cvxpy, G, mu, F, length, A=None, effort=None, min_normal=0.0):
    """Least squared forces; None where there are none."""
    f = cvxpy.Variable(G.shape[1])
    G_n, F_n = scaled(G, length), scaled(F[:, None], length)[:, 0]
    rows = [G_n @ f + F_n == 0, *cones(cvxpy, f, mu, G.shape[1] // 3, min_normal)]
    if A is not None:
        rows.append(cvxpy.abs(A @ f) <= effort)
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(f)), rows)
    problem.solve("CLARABEL")
    return f.value if problem.status == "optimal" else None


def task_reference(cvxpy, G, mu, F, disturbances, length, A, effort):
    """All disturbances in one program with one s."""
    s = cvxpy.Variable()
    rows = [s >= 0, s <= 100]
    G_n, F_n, D_n = scaled(G, length), scaled(F[:, None], length)[:, 0], scaled(disturbances.T, length).T
    for d in D_n:
        f = cvxpy.Variable(G.shape[1])
        rows += [G_n @ f + F_n + s * d == 0, *cones(cvxpy, f, mu, G.shape[1] // 3), cvxpy.abs(A @ f) <= effort]
    problem = cvxpy.Problem(cvxpy.Maximize(s), rows)
    problem.solve("CLARABEL")
    return float(s.value) if problem.status == "optimal" else 0.0


def reach_reference(cvxpy, G_n, mu, direction):
    """Greatest t with t * direction in {G f : f in cones, sum f_n <= 1}."""
    f, t = cvxpy.Variable(G_n.shape[1]), cvxpy.Variable()
    rows = [G_n @ f == t * direction, cvxpy.sum(f[2::3]) <= 1, *cones(cvxpy, f, mu, G_n.shape[1] // 3)]
    cvxpy.Problem(cvxpy.Maximize(t), rows).solve("CLARABEL")
    return float(t.value)
