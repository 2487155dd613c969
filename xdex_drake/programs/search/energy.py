"""The energy of Eq. (1) of a batch of candidates, with its gradient."""

from __future__ import annotations

import torch

from xdex_drake.programs import terms
from xdex_drake.programs.search.candidates import State
from xdex_drake.programs.search.problem import SearchProblem


def evaluate(problem: SearchProblem, state: State) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
    """Energy of Eq. (1) for each candidate, with its gradient.

    Updates `state.forces` by some projected-gradient steps first, so that the gradient is the envelope's.

    Args:
        problem: The problem.
        state: The candidates.

    Returns:
        Energy, shape (B,), gradient with respect to (w_WH, v_WH, qdot), shape (B, 6 + n), and the unweighted terms.
    """
    batched, settings, weights = problem.batched, problem.settings, problem.settings.weights
    B = state.q.shape[0]
    poses = batched.forward(state.R_WH, state.p_WH, state.q)
    centers = problem.spheres.positions(poses)  # (B, 3, n_spheres)
    R_OW = problem.R_WO.T
    distance, slope_O = problem.grid.nearest(R_OW @ (centers - problem.p_WO[:, None]))
    radii = problem.radii

    # Contacts: of each finger the tip sphere that is nearest to the surface.
    gaps = (distance - radii)[:, problem.tip_spheres]  # (B, n_fingers, k)
    choice = gaps.argmin(-1)
    sphere = torch.gather(problem.tip_spheres.expand(B, -1, -1), 2, choice[..., None])[..., 0]  # (B, n_fingers)
    contact_centers = torch.gather(centers, 2, sphere[:, None].expand(-1, 3, -1)).transpose(1, 2)
    contact_radii = radii[sphere]
    d, n_O, H_O = problem.grid.smooth((contact_centers - problem.p_WO) @ problem.R_WO)
    outward = n_O @ problem.R_WO.T
    H = problem.R_WO @ H_O @ problem.R_WO.T
    normals = -outward
    points = contact_centers - d[..., None] * outward
    mask = state.fingers

    value_dis, g_dis = terms.contact_distance(d, contact_radii, mask)

    # Penetration: the fingers that touch keep no clearance.
    keep_off = radii + settings.clearance
    value_sdf, g_sdf = terms.penetration(distance, keep_off)
    height = centers[:, 2]
    value_table, g_table = terms.penetration(height, keep_off)

    force = state.forces * mask[..., None]
    mu = settings.friction_fraction * problem.friction
    if settings.estimator == "normals":
        force = normals * mask[..., None]
    else:
        step = 1.0 / (2.0 * mask.sum(-1).clamp_min(1.0))[:, None, None]
        G = terms.grasp_map(points, problem.p_WOcm, problem.length)
        Gt = G.transpose(1, 2)
        for _ in range(settings.force_steps):
            descent = (Gt @ (G @ force.flatten(1)[..., None])).view_as(force)
            force = terms.project_forces(force - step * descent, normals, mu, 0.3, 1.5) * mask[..., None]
        state.forces = force
    value_fc, g_point, g_normal = terms.wrench_energy(points, normals, force, problem.p_WOcm, problem.length)

    pad_W = (poses.R_WLs[:, problem.tip_links] @ problem.pads[:, :, None])[..., 0]
    value_pad, g_pad_normal, g_pad = terms.alignment(normals, pad_W, settings.pad_cosine, mask)

    value_s, g_between = terms.self_collision(problem.pairs.positions(poses).transpose(1, 2), problem.reach)
    value_j, g_j = terms.joint_limits(state.q, batched.limits)

    # Gradients with respect to sphere centers.
    g_centers = weights.sdf * (problem.R_WO @ (g_sdf[:, None] * slope_O))
    g_centers[:, 2] += weights.sdf * g_table
    on_normal = weights.fc * g_normal + weights.pad * g_pad_normal
    on_point = weights.fc * g_point
    wishes = {}
    if settings.spread > 0.0:
        wishes["spread"], g_spread = terms.finger_spread(points, settings.spread, mask)
        on_point = on_point + weights.spread * g_spread
    # A contact is the surface point nearest to its sphere: dp = (1 - n n^T - d H) dc, dn_in = -H dc.
    Ht = H.transpose(-1, -2)
    g_contact = (
        on_point
        - outward * (outward * on_point).sum(-1, keepdim=True)
        - d[..., None] * (Ht @ on_point[..., None])[..., 0]
        - (Ht @ on_normal[..., None])[..., 0]
        + weights.dis * g_dis[..., None] * outward
    )
    on_links = (
        problem.spheres.wrenches(poses, g_centers)
        + problem.pairs.wrenches(poses, weights.s * g_between.transpose(1, 2))
        + batched.wrenches(
            problem.tip_links, contact_centers, g_contact, torque=weights.pad * terms.cross(pad_W, g_pad)
        )
    )
    gradient = batched.to_tangent(poses, on_links)
    gradient[:, 6:] += weights.j * g_j
    if settings.approach is not None:
        a_W = state.R_WH @ problem.approach
        wanted = torch.as_tensor(settings.approach, dtype=a_W.dtype, device=a_W.device)
        wishes["approach"], g_a = terms.approach(a_W, wanted / wanted.norm(), settings.approach_cosine)
        gradient[:, :3] += weights.approach * terms.cross(a_W, g_a)
    values = {
        "fc": value_fc,
        "dis": value_dis,
        "sdf": value_sdf + value_table,
        "j": value_j,
        "s": value_s,
        "pad": value_pad,
        **wishes,
    }
    energy = sum(getattr(weights, name) * value for name, value in values.items())
    return energy, gradient, values  # type: ignore[return-value]
