"""Loss terms of the model: pure functions, named as in the paper."""

import torch
from torch import Tensor


def reconstruction_loss(predicted: Tensor, poses: Tensor, mask: Tensor) -> Tensor:
    """Squared error of the link pose vectors, first term of Eq. (5).

    The paper sums over links; here it is their mean, so that a hand of 28 links does not outweigh one of seven.

    Args:
        predicted: Predicted normalised pose vectors, shape (B, L, 9).
        poses: True ones, shape (B, L, 9).
        mask: True where a link is real, shape (B, L).

    Returns:
        Mean over grasps of the mean over links, shape ().
    """
    error = (predicted - poses).square().sum(dim=-1).masked_fill(~mask, 0.0)  # (B, L)
    return (error.sum(dim=1) / mask.sum(dim=1)).mean()


def kl_loss(mean: Tensor, log_sigma: Tensor, free: float = 0.0) -> Tensor:
    """KL divergence of N(mean, sigma^2) from N(0, I), second term of Eq. (5).

    Args:
        mean: Means, shape (B, latent).
        log_sigma: Logarithms of the standard deviations, shape (B, latent).
        free: Divergence that each dimension may have for nothing, on the mean over grasps [nat] (Kingma et al. 2016).

    Returns:
        Mean over grasps, summed over dimensions [nat], shape ().
    """
    each = (0.5 * (mean.square() + (2.0 * log_sigma).exp() - 1.0) - log_sigma).mean(dim=0)
    return each.clamp(min=free).sum() if free > 0.0 else each.sum()


def point_loss(logits: Tensor, weights: Tensor) -> Tensor:
    """Cross entropy between where the grasps of a scene head and the softmax of the logits.

    Args:
        logits: Logits of the object's points, shape (S, N).
        weights: How much each point is headed for, non-negative, positive somewhere in each row, shape (S, N).

    Returns:
        Mean over scenes [nat], shape (); log N for a uniform softmax.
    """
    target = weights / weights.sum(dim=1, keepdim=True)
    return -(target * torch.log_softmax(logits, dim=1)).sum(dim=1).mean()


def keypoint_loss(first: Tensor, second: Tensor, shared: Tensor) -> Tensor:
    """Retargeting loss: squared distance of corresponding keypoints of two hands, given one latent.

    The paper prints a difference of link poses, which hands with different links do not have; as in its Eq. (2) we
    compare keypoints, which correspond by name.

    Args:
        first: Keypoints of the first hands, shape (B, K, 3).
        second: Keypoints of the second hands, shape (B, K, 3).
        shared: True where both hands have the keypoint, shape (B, K).

    Returns:
        Mean over pairs of the mean over shared keypoints, in the square of the inputs' unit, shape (); 0 without any.
    """
    error = (first - second).square().sum(dim=-1).masked_fill(~shared, 0.0)
    return (error.sum(dim=1) / shared.sum(dim=1).clamp(min=1)).sum() / shared.any(dim=1).sum().clamp(min=1)


def embedding_loss(first: Tensor, second: Tensor) -> Tensor:
    """Squared distance |mu_1 - mu_2|^2 between the latent means of two hands' versions of one grasp.

    Args:
        first: Means, shape (B, latent).
        second: Means, shape (B, latent).

    Returns:
        Mean over pairs, shape (); 0 without any.
    """
    return (first - second).square().sum() / max(len(first), 1)


def keypoints(poses: Tensor, link: Tensor, offset: Tensor) -> Tensor:
    """Keypoints from link pose vectors.

    A keypoint moves with its link: p_WK = p_WG + R_WG p_GK.

    Args:
        poses: Link pose vectors with any 6-D rotation part, shape (B, L, 9).
        link: Index of each keypoint's link, shape (B, K), int64.
        offset: Offsets p_GK in the unit of the poses' positions, shape (B, K, 3).

    Returns:
        Keypoints, shape (B, K, 3).
    """
    chosen = poses.gather(1, link[:, :, None].expand(-1, -1, 9))  # (B, K, 9)
    rotation = rotations_from_columns(chosen[..., 3:])  # (B, K, 3, 3)
    return chosen[..., :3] + (rotation @ offset[..., None]).squeeze(-1)


def rotations_from_columns(columns: Tensor) -> Tensor:
    """Rotations from their first two columns by Gram-Schmidt (Zhou et al. 2019).

    Args:
        columns: The two columns one after the other, not parallel, shape (..., 6).

    Returns:
        Rotation matrices, shape (..., 3, 3).
    """
    x = torch.nn.functional.normalize(columns[..., :3], dim=-1)
    y = columns[..., 3:] - (columns[..., 3:] * x).sum(dim=-1, keepdim=True) * x
    y = torch.nn.functional.normalize(y, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)
