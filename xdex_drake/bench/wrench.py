"""Times of the wrench programs, and how exact they are, on random grasps of a ball."""

from __future__ import annotations

import numpy as np

from xdex_drake import contact
from xdex_drake.bench.watch import Tick, Watch
from xdex_drake.contact.conic import cone_rows, diagonal, full_matrix, program_cones, solve_conic

RADIUS, MASS, MU = 0.035, 0.1, 0.6
SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)


def bench_wrench(watch: Watch, *, repeats: int, seed: int, tick: Tick) -> None:
    """Grasps of three, four and six contacts, fingers of three joints behind them; each program runs five times.

    Args:
        watch: Where times go: balance (the solver alone, with building, with pyramids for cones, within efforts), task
            margin, margins with gradients, ball margin, certificate, re-check. Facts are the worst residual of a
            certificate and the widest bracket.
        repeats: Number of grasps of each number of contacts.
        seed: Seed of the grasps.
        tick: Called after each grasp.
    """
    rng = np.random.default_rng(seed)
    gravity, pushes = contact.gravity_wrench(MASS), contact.push_wrenches(MASS)
    held = contact.HeldObject(MASS, RADIUS, np.zeros(3), MU, np.eye(3))
    for n in (3, 4, 6):
        for _ in range(repeats):
            out = rng.normal(size=(n, 3)) + 1.5 * SIDES[:n]
            out /= np.linalg.norm(out, axis=1, keepdims=True)
            R_WCs, G = contact.contact_frames(-out), held.grasp_map(RADIUS * out, -out).G
            A = np.zeros((3 * n, 3 * n))
            for i in range(n):  # a finger of three joints, 10 cm from root to tip, under each contact
                A[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = rng.normal(scale=0.05, size=(3, 3)) @ R_WCs[i]
            effort = contact.Effort(A, np.full(3 * n, 0.7))
            program = _program(contact.GraspMap(G, MU, RADIUS), gravity)
            four = n == 4

            # A grasp map keeps what programs share, so each run has one of its own.
            def new(G: np.ndarray = G) -> contact.GraspMap:
                return contact.GraspMap(G, MU, RADIUS)

            watch.time_often(
                f"balance, {n} contacts, solver alone",
                lambda p=program: solve_conic(*p),
                target_ms=0.3 if four else None,
            )
            watch.time_often(
                f"balance, {n} contacts",
                lambda new=new: contact.balance(new(), gravity),
                target_ms=0.6 if four else None,
            )
            watch.time_often(f"balance with pyramids, {n}", lambda new=new: contact.balance_linearized(new(), gravity))
            watch.time_often(
                f"balance within efforts, {n}",
                lambda new=new, effort=effort: contact.balance(new(), gravity, effort=effort),
            )
            watch.time_often(
                f"task margin, six pushes, {n}",
                lambda new=new, effort=effort: contact.task_margin(new(), gravity, pushes, effort=effort),
            )
            watch.time_often(
                f"margins with gradients, six pushes, {n}",
                lambda out=out: contact.push_margins(RADIUS * out, -out, MU, RADIUS, most_force=6.0),
            )
            ball = watch.time_often(
                f"ball margin to 1e-3, {n}",
                lambda new=new: contact.ball_margin(new()),
                target_ms=5.0 if four else None,
            )
            bracket = ball.upper - ball.lower
            watch.facts["widest bracket"] = max(watch.facts.get("widest bracket", 0.0), bracket)
            links = [f"finger {i}" for i in range(n)]
            result = watch.time_often(
                f"certificate, {n}",
                lambda out=out, links=links, effort=effort: contact.certify(
                    RADIUS * out, -out, links, held, effort=effort
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


def _program(grasp_map: contact.GraspMap, F: np.ndarray) -> tuple:
    """Arguments of `solve_conic` for the balance program."""
    n, holding, mus = grasp_map.contacts, grasp_map.holding, grasp_map.mus
    f = holding.of(grasp_map.scaling * F / np.linalg.norm(F))
    m = holding.null.shape[1]
    rows, right = full_matrix(-cone_rows(mus, holding.null)), cone_rows(mus, f)
    return diagonal(np.ones(m)), np.zeros(m), rows, right, list(program_cones(0, n))
