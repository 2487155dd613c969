"""What a depth camera sees of an object: partial point clouds, rendered by Drake without a window."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    DepthRange,
    DepthRenderCamera,
    GeometryInstance,
    MakeRenderEngineVtk,
    PerceptionProperties,
    QueryObject,
    RenderCameraCore,
    RenderEngineVtkParams,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError, MissingExtra
from xdex_drake.scene.bodies import visual_mesh
from xdex_drake.scene.tabletop import Scene

_RENDERER = "depth"
_PROBE = "from xdex_drake.scene.camera import _probe; _probe()"


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole camera.

    Attributes:
        width: Width of the image [pixels].
        height: Height of the image [pixels].
        fov_y: Vertical field of view [rad].
        near: Least depth [m].
        far: Greatest depth [m].
    """

    width: int = 320
    height: int = 240
    fov_y: float = 0.75
    near: float = 0.1
    far: float = 3.0


@dataclass(frozen=True)
class DepthNoise:
    """Errors of a depth camera, the size of those of common stereo cameras at half a metre.

    Attributes:
        constant_m: Standard deviation of depth at any depth [m].
        square: Standard deviation of depth that grows with its square [1/m].
        lateral_px: Standard deviation of where in the image a pixel looks [pixels].
        dropout: Share of pixels that are lost at random.
        grazing_rad: Pixels are lost where the surface is seen at a flatter angle [rad].
    """

    constant_m: float = 5e-4
    square: float = 2e-3
    lateral_px: float = 0.3
    dropout: float = 0.02
    grazing_rad: float = math.radians(10.0)


CAMERA = DepthCamera()
NOISE = DepthNoise()
NO_NOISE = DepthNoise(0.0, 0.0, 0.0, 0.0, 0.0)


def _add_renderer(scene_graph: SceneGraph) -> None:
    # EGL needs no display. Where VTK has one kind of window only, its default is taken.
    backend = "EGL" if sys.platform.startswith("linux") else ""
    scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(RenderEngineVtkParams(backend=backend)))


def _render(scene_graph: SceneGraph, camera: DepthCamera, X_WC: RigidTransform) -> Array:
    info = CameraInfo(width=camera.width, height=camera.height, fov_y=camera.fov_y)
    clipping = ClippingRange(0.5 * camera.near, 2.0 * camera.far)
    core = RenderCameraCore(_RENDERER, info, clipping, RigidTransform())
    query = cast(QueryObject, scene_graph.get_query_output_port().Eval(scene_graph.CreateDefaultContext()))
    depth_camera = DepthRenderCamera(core, DepthRange(camera.near, camera.far))
    image = query.RenderDepthImage(depth_camera, scene_graph.world_frame_id(), X_WC)
    return np.array(image.data[:, :, 0], dtype=np.float64)


def _probe() -> None:
    """Renders an empty picture; run in a process of its own, since graphics libraries crash rather than raise."""
    scene_graph = SceneGraph()
    _add_renderer(scene_graph)
    _render(scene_graph, DepthCamera(32, 24), RigidTransform())


def survives(code: str) -> bool:
    """Whether a process of its own gets through some Python code: graphics libraries crash rather than raise.

    Args:
        code: The code.

    Returns:
        Whether the process ended well within two minutes.
    """
    try:
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=120, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return result.returncode == 0


@cache
def can_see() -> bool:
    """Whether this machine can render depth; tried once, in another process, since failing may end the process."""
    return survives(_PROBE)


def look_at(p_WC: Array, p_WT: Array) -> RigidTransform:
    """Pose of a camera that looks at a point, upright.

    Args:
        p_WC: Position of the camera [m], shape (3,).
        p_WT: The point [m], shape (3,).

    Returns:
        X_WC, z forward and y down.

    Raises:
        ConfigError: The two coincide.
    """
    forward = np.asarray(p_WT, dtype=np.float64) - p_WC
    if np.linalg.norm(forward) < 1e-6:
        raise ConfigError("the camera is at the point that it looks at; move it away")
    forward = forward / np.linalg.norm(forward)
    # Straight down there is no upright; x of W is as good as any.
    side = np.cross(forward, [0.0, 0.0, 1.0])
    right = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    return RigidTransform(RotationMatrix(np.column_stack([right, np.cross(forward, right), forward])), p_WC)


def camera_poses(
    scene: Scene,
    n: int,
    rng: np.random.Generator,
    *,
    distance: tuple[float, float] = (0.4, 0.7),
    elevation: tuple[float, float] = (math.radians(15.0), math.radians(75.0)),
) -> list[RigidTransform]:
    """Poses spread evenly over a part of the upper hemisphere, each looking at the middle of the object.

    Args:
        scene: The scene.
        n: Number of poses.
        rng: Source of randomness.
        distance: Range of the distance from the object's middle [m].
        elevation: Range of the elevation above the table [rad].

    Returns:
        The poses X_WC.
    """
    vertices = scene.object.vertices
    p_WT = scene.X_WO @ (0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))
    poses = []
    for _ in range(n):
        azimuth = rng.uniform(-math.pi, math.pi)
        # Even on the sphere: the sine of the elevation is uniform.
        up = rng.uniform(math.sin(elevation[0]), math.sin(elevation[1]))
        flat = math.sqrt(1.0 - up * up)
        direction = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), up])
        poses.append(look_at(p_WT + rng.uniform(*distance) * direction, p_WT))
    return poses


def depth_cloud(
    scene: Scene,
    X_WC: RigidTransform,
    *,
    camera: DepthCamera = CAMERA,
    noise: DepthNoise = NOISE,
    rng: np.random.Generator | None = None,
    in_world: bool = True,
) -> Array:
    """Points of the object that a depth camera sees; the table is left out.

    Frames are those of `tabletop.point_cloud`.

    Args:
        scene: The scene.
        X_WC: Pose of the camera, z forward and y down.
        camera: The camera.
        noise: Its errors.
        rng: Source of the errors; seeded with 0 where None.
        in_world: Whether the points are expressed in W; otherwise in O.

    Returns:
        Points [m], shape (n, 3), in the order of the image's rows; none where the object is out of sight.

    Raises:
        MissingExtra: This machine cannot render.
    """
    if not can_see():
        raise MissingExtra(
            "depth cannot be rendered on this machine; install its OpenGL library (Debian and Ubuntu: "
            "`apt install libegl1 libgl1-mesa-dri`), or use the full cloud"
        )
    rng = np.random.default_rng(0) if rng is None else rng
    scene_graph = SceneGraph()
    _add_renderer(scene_graph)
    instance = GeometryInstance(scene.X_WO, visual_mesh(scene.object), "object")
    instance.set_perception_properties(PerceptionProperties())
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("camera"), instance)
    # The table is not drawn: from above it hides nothing of what stands on it.
    depth = _render(scene_graph, camera, X_WC)
    focal = 0.5 * camera.height / math.tan(0.5 * camera.fov_y)
    rows, columns = np.nonzero(np.isfinite(depth) & (depth > 0.0))
    z = depth[rows, columns]
    # The renderer looks through the middle of a pixel, and counts the principal point from the image's corner.
    center_x, center_y = 0.5 * camera.width - 0.5, 0.5 * camera.height - 0.5
    rays = np.column_stack([(columns + 0.5 - center_x) / focal, (rows + 0.5 - center_y) / focal, np.ones(len(z))])
    keep = rng.random(len(z)) >= noise.dropout
    if noise.grazing_rad > 0.0 and len(z):
        keep &= _facing(scene, X_WC, z[:, None] * rays) > math.sin(noise.grazing_rad)
    z, rays = z[keep], rays[keep]
    rays[:, :2] += rng.normal(0.0, 1.0, (len(z), 2)) * (noise.lateral_px / focal)
    z = z + rng.normal(0.0, 1.0, len(z)) * (noise.constant_m + noise.square * z**2)
    p_WPs = (z[:, None] * rays) @ X_WC.rotation().matrix().T + X_WC.translation()
    if in_world:
        return p_WPs
    return (p_WPs - scene.X_WO.translation()) @ scene.X_WO.rotation().matrix()


def _facing(scene: Scene, X_WC: RigidTransform, p_CPs: Array) -> Array:
    """Sine of the angle between the line of sight and the surface at each point, shape (n,)."""
    X_OC = scene.X_WO.inverse() @ X_WC
    exact = scene.object.mesh_distance
    p_OPs = p_CPs @ X_OC.rotation().matrix().T + X_OC.translation()
    sight = p_OPs - X_OC.translation()
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    return np.abs(np.einsum("ij,ij->i", sight, exact.query(p_OPs).gradient))
