"""Times of the wrench programs, and how exact they are, on random grasps of a ball."""

from __future__ import annotations

import numpy as np

from xdex_drake import contact
from xdex_drake.bench.watch import Tick, Watch
from xdex_drake.contact.conic import (
    cone_rows,
    diagonal,
    full_matrix,
    holding_forces,
    program_cones,
    solve_conic,
    torque_scaling,
)

RADIUS, MASS, MU = 0.035, 0.1, 0.6
SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)


def bench_wrench(watch: Watch, *, repeats: int, seed: int, tick: Tick) -> None:
    """Grasps of three, four and six contacts, fingers of three joints behind them; each program runs five times.

    Args:
        watch: Where times go: balance (the solver alone, with building, within efforts), task margin, ball margin,
            certificate, re-check. Facts are the worst residual of a certificate and the widest bracket.
        repeats: Number of grasps of each number of contacts.
        seed: Seed of the grasps.
        tick: Called after each grasp.
    """
    rng = np.random.default_rng(seed)
    gravity, pushes = contact.gravity_wrench(MASS), contact.push_wrenches(MASS)
    for n in (3, 4, 6):
        for _ in range(repeats):
            out = rng.normal(size=(n, 3)) + 1.5 * SIDES[:n]
            out /= np.linalg.norm(out, axis=1, keepdims=True)
            R_WCs, G = contact.contact_geometry(RADIUS * out, -out, np.eye(3), np.zeros(3))
            A = np.zeros((3 * n, 3 * n))
            for i in range(n):  # a finger of three joints, 10 cm from root to tip, under each contact
                A[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = rng.normal(scale=0.05, size=(3, 3)) @ R_WCs[i]
            within = {"A": A, "effort": np.full(3 * n, 0.7), "length": RADIUS}
            program = _program(G, gravity)
            four = n == 4
            watch.time_often(
                f"balance, {n} contacts, solver alone",
                lambda p=program: solve_conic(*p),
                target_ms=0.3 if four else None,
            )
            watch.time_often(
                f"balance, {n} contacts",
                lambda G=G: contact.balance(G, MU, gravity, length=RADIUS),
                target_ms=0.6 if four else None,
            )
            watch.time_often(f"balance within efforts, {n}", lambda G=G, w=within: contact.balance(G, MU, gravity, **w))
            watch.time_often(
                f"task margin, six pushes, {n}",
                lambda G=G, w=within: contact.task_margin(
                    G, MU, gravity, pushes, w["A"], w["effort"], length=w["length"]
                ),
            )
            ball = watch.time_often(
                f"ball margin to 1e-3, {n}",
                lambda G=G: contact.ball_margin(G, MU, length=RADIUS),
                target_ms=5.0 if four else None,
            )
            bracket = ball.upper - ball.lower
            watch.facts["widest bracket"] = max(watch.facts.get("widest bracket", 0.0), bracket)
            result = watch.time_often(
                f"certificate, {n}",
                lambda out=out, w=within: contact.certify(
                    RADIUS * out,
                    -out,
                    [f"finger {i}" for i in range(len(out))],
                    mu=MU,
                    mass=MASS,
                    p_OOcm=np.zeros(3),
                    R_WO=np.eye(3),
                    **w,
                ),
            )
            if result.certificate is not None:
                watch.count("certified")
                left = watch.time_often(
                    f"check without a solver, {n}",
                    lambda c=result.certificate: contact.check_certificate(c),
                    target_ms=5.0 if four else None,
                )
                worst = max(vars(left).values())
                watch.facts["worst residual"] = max(watch.facts.get("worst residual", 0.0), worst)
            tick()


def _program(G: np.ndarray, F: np.ndarray) -> tuple:
    """Arguments of `solve_conic` for the balance program."""
    n, scaling = G.shape[1] // 3, torque_scaling(RADIUS)
    holding = holding_forces(scaling[:, None] * G)
    f, mus = holding.of(scaling * F / np.linalg.norm(F)), np.full(n, MU)
    m = holding.null.shape[1]
    rows, right = full_matrix(-cone_rows(mus, holding.null)), cone_rows(mus, f)
    return diagonal(np.ones(m)), np.zeros(m), rows, right, list(program_cones(0, n))
