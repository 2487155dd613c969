"""The dex-retargeting side of `run.py`, in an environment of its own: facts of its links, or a stream of targets.

Run by `run.py` as `python peer.py JOB.json OUT.npz`; it knows nothing of xdex_drake.
"""

import json
import sys
import time

import numpy as np
import pinocchio as pin  # pyright: ignore - of its own environment
import torch
from dex_retargeting.retargeting_config import RetargetingConfig  # pyright: ignore


def build(job: dict, objective: str, normal_delta: float):  # noqa: ANN201
    """A retargeter of the job's hand, without filter."""
    tips, count = job["tips"], len(job["tips"])
    links = (
        {"target_link_names": tips, "target_link_human_indices": list(range(count))}
        if objective == "position"
        else {
            "target_origin_link_names": [job["origin"]] * count,
            "target_task_link_names": tips,
            "target_link_human_indices": [[0] * count, list(range(count))],
        }
    )
    config = {"type": objective, "urdf_path": job["urdf"], "target_joint_names": job["joints"], "low_pass_alpha": -1.0}
    return RetargetingConfig.from_dict({**config, **links, "normal_delta": normal_delta}).build()


def facts(job: dict) -> dict[str, np.ndarray]:
    """Where its tip links are: joint that carries each, offset from it, and poses at random joint values."""
    retargeter = build(job, "vector", 0.0)
    optimizer, robot = retargeter.optimizer, retargeter.optimizer.robot
    limits, rng = retargeter.joint_limits, np.random.default_rng(0)
    q = limits[:, 0] + rng.random((20, len(limits))) * (limits[:, 1] - limits[:, 0])
    ids = [robot.get_link_index(name) for name in job["tips"]]
    tips = []
    for row in q:
        full = np.zeros(robot.dof)
        full[optimizer.idx_pin2target] = row
        if optimizer.adaptor is not None:
            full = optimizer.adaptor.forward_qpos(full)
        robot.compute_forward_kinematics(full)
        tips.append([robot.get_link_pose(k)[:3, 3] for k in ids])
    frames = [robot.model.frames[k] for k in ids]
    robot.compute_forward_kinematics(np.zeros(robot.dof))
    return {
        "joints": np.array([robot.model.names[frame.parentJoint] for frame in frames]),
        "offsets": np.array([frame.placement.translation for frame in frames]),
        "base": robot.get_link_pose(robot.get_link_index(job["base"])),
        "origin": robot.get_link_pose(robot.get_link_index(job["origin"])),
        "q": q,
        "tips": np.array(tips),
        "versions": np.array([pin.__version__, torch.__version__, np.__version__]),
    }


def streams(job: dict) -> dict[str, np.ndarray]:
    """All runs of a job, each repeated; of the times the least."""
    out = {}
    for name, run in job["runs"].items():
        found = [stream({**job, **run}) for _ in range(job["repeats"])]
        out[f"{name}_q"], out[f"{name}_seconds"] = found[0]["q"], min(one["seconds"] for one in found)
    return out


def stream(job: dict) -> dict[str, np.ndarray]:
    """Joint values of clips of targets, each a stream of its own, and processor time a frame but the first [s]."""
    retargeter = build(job, job["objective"], job["normal_delta"])
    clips = np.array(job["targets"])
    index, fixed = retargeter.optimizer.idx_pin2target, np.zeros(len(retargeter.optimizer.idx_pin2fixed))
    found, seconds = [], 0.0
    for clip in clips:
        retargeter.reset()
        found.append(retargeter.retarget(clip[0], fixed)[index])
        start = time.process_time()
        for row in clip[1:]:
            found.append(retargeter.retarget(row, fixed)[index])
        seconds += (time.process_time() - start) / (len(clips) * (len(clip) - 1))
    return {"q": np.array(found), "seconds": np.array(seconds)}


if __name__ == "__main__":
    torch.set_num_threads(1)
    RetargetingConfig.set_default_urdf_dir("/")
    with open(sys.argv[1]) as file:
        content = json.load(file)
    np.savez(sys.argv[2], **(streams(content) if "runs" in content else facts(content)))  # pyright: ignore - names of arrays
