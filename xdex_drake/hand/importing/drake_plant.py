"""Reads a robot out of a Drake plant."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import trimesh
from pydrake.geometry import Box as DrakeBox
from pydrake.geometry import Capsule as DrakeCapsule
from pydrake.geometry import Convex as DrakeConvex
from pydrake.geometry import Cylinder as DrakeCylinder
from pydrake.geometry import Ellipsoid as DrakeEllipsoid
from pydrake.geometry import GeometryId, SceneGraph, SceneGraphInspector, Shape
from pydrake.geometry import Mesh as DrakeMesh
from pydrake.geometry import Sphere as DrakeSphere
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import AddMultibodyPlantConstraints
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Joint,
    ModelInstanceIndex,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    RpyFloatingJoint,
    WeldJoint,
)
from pydrake.solvers import MathematicalProgram

from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Sphere
from xdex_drake.hand.importing.mesh_files import MAX_BYTES, ellipsoid, placed
from xdex_drake.hand.importing.model import (
    Cylinder,
    FileGeometry,
    FileInertia,
    FileJoint,
    FileLink,
    FileMimic,
    FileModel,
    TriangleMesh,
)
from xdex_drake.hand.importing.tree import as_one_tree, check_mimics
from xdex_drake.hand.importing.xml_file import check_names
from xdex_drake.mesh_file import read_triangles


def model_from_plant(
    plant: MultibodyPlant, model_instance: ModelInstanceIndex, *, scene_graph: SceneGraph | None = None
) -> FileModel:
    """Reads the bodies, joints, couplings, actuators and geometry of one model instance.

    Joints that tie the hand to something else (a weld to the world or to an arm) are not part of it. The limits,
    default inertias and collision filters are the plant's. Couplings can be read from a finalized plant only; a
    finalized plant does not hand out its scene graph, so give it for the geometry.

    Args:
        plant: The plant, finalized or not.
        model_instance: The hand's model instance.
        scene_graph: The plant's scene graph; needed where the plant is finalized.

    Returns:
        The robot as the plant has it. A link's frame lies at its joint, so it differs from the body's frame where the
        joint is not at the body's origin.

    Raises:
        HandFileError: The instance has no bodies, is not one tree, or has a joint that is neither revolute, prismatic
            nor a weld.
    """
    name = plant.GetModelInstanceName(model_instance)
    source = f"model instance {name!r}"
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(model_instance)]
    # The world body is nobody's hand.
    bodies = [body for body in bodies if body.index() != plant.world_body().index()]
    if not bodies:
        raise HandFileError(f"{source}: has no bodies; give the model instance that the parser returned for the hand")
    check_names([body.name() for body in bodies], "body", source)
    notes: list[str] = []
    joints_of_plant = [
        joint
        for joint in (plant.get_joint(index) for index in plant.GetJointIndices())
        if not isinstance(joint, QuaternionFloatingJoint | RpyFloatingJoint)
    ]
    bodies = _with_world(plant, bodies, joints_of_plant)
    inside = {body.index() for body in bodies}
    tree = [j for j in joints_of_plant if {j.parent_body().index(), j.child_body().index()} <= inside]
    # L of each body's link is at its joint: X_LB = inv(X_BM).
    X_LB = {joint.child_body().index(): joint.frame_on_child().GetFixedPoseInBodyFrame().inverse() for joint in tree}
    X_LBs = [X_LB.get(body.index(), RigidTransform()) for body in bodies]
    efforts = _efforts(plant, model_instance)
    mimics = _couplings(plant, tree, notes)
    joints = tuple(_joint(joint, source, X_LB, efforts, mimics) for joint in tree)
    check_mimics(joints, source)
    inspector = _inspector(plant, scene_graph)
    if inspector is None:
        notes.append("no geometry could be read: give the scene graph of the finalized plant")
    links = tuple(_link(plant, inspector, body, X, notes) for body, X in zip(bodies, X_LBs, strict=True))
    links, joints = as_one_tree(source, links, joints, notes)
    pairs = () if inspector is None else tuple(_filtered(plant, inspector, bodies, {link.name for link in links}))
    return FileModel(name, source, links, joints, pairs, tuple(notes))


def _with_world(plant: MultibodyPlant, bodies: list[RigidBody], joints: list[Joint]) -> list[RigidBody]:
    """The bodies, and the world as their base where several of them hang on it by joints of their own."""
    inside = {body.index() for body in bodies}
    held = {joint.child_body().index() for joint in joints if joint.parent_body().index() in inside}
    hanging = {
        joint.child_body().index()
        for joint in joints
        if joint.parent_body().index() == plant.world_body().index() and joint.child_body().index() in inside
    }
    if len(inside - held) > 1 and inside - held <= hanging:
        return [plant.world_body(), *bodies]
    return bodies


def _inspector(plant: MultibodyPlant, scene_graph: SceneGraph | None) -> SceneGraphInspector | None:
    if not plant.geometry_source_is_registered():
        return None
    if scene_graph is not None:
        return scene_graph.model_inspector()
    if plant.is_finalized():
        return None
    # The plant does not hand out its scene graph in Python; a parser made for the plant does.
    return Parser(plant).scene_graph().model_inspector()


def _efforts(plant: MultibodyPlant, instance: ModelInstanceIndex) -> dict[str, float]:
    """Effort limit of each driven joint, by the joint's name; empty where there are no actuators."""
    # Asked for those of one instance, a plant that is not finalized names none.
    actuators = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    return {a.joint().name(): a.effort_limit() for a in actuators if a.model_instance() == instance}


def _couplings(plant: MultibodyPlant, tree: list[Joint], notes: list[str]) -> dict[str, FileMimic]:
    if plant.num_constraints() == 0:
        return {}
    if not plant.is_finalized():
        notes.append("couplings can be read from a finalized plant only; the joints count as independent")
        return {}
    program = MathematicalProgram()
    q = program.NewContinuousVariables(plant.num_positions())
    try:
        AddMultibodyPlantConstraints(plant, q, program)
    except RuntimeError as error:
        notes.append(f"the plant's constraints could not be read ({' '.join(str(error).split())[:120]})")
        return {}
    index_of = {variable.get_id(): k for k, variable in enumerate(q)}
    at = {joint.position_start(): joint.name() for joint in tree if joint.num_positions() == 1}
    mimics = {}
    for binding in program.linear_equality_constraints():
        columns = [index_of[variable.get_id()] for variable in binding.variables()]
        row, right = binding.evaluator().GetDenseA(), binding.evaluator().upper_bound()
        # A coupler is one row q0 - ratio q1 = offset, its variables in any order.
        if row.shape != (1, 2) or 1.0 not in row or not set(columns) <= set(at):
            continue
        first = int(np.flatnonzero(row[0] == 1.0)[-1])
        slave, master = at[columns[first]], at[columns[1 - first]]
        mimics[slave] = FileMimic(master, float(-row[0, 1 - first]), float(right[0]))
    return mimics


def _joint(
    joint: Joint,
    source: str,
    X_LB: dict,
    efforts: dict[str, float],
    mimics: dict[str, FileMimic],
) -> FileJoint:
    parent = joint.parent_body()
    X_PJ = X_LB.get(parent.index(), RigidTransform()) @ joint.frame_on_parent().GetFixedPoseInBodyFrame()
    ends = (parent.name(), joint.child_body().name())
    if isinstance(joint, WeldJoint):
        # The weld's own offset lies between the frames on parent and child.
        X_PJ = X_PJ @ joint.X_FM()
        return FileJoint(
            joint.name(), "fixed", *ends, X_PJ.translation(), X_PJ.rotation().matrix(), np.array([1.0, 0.0, 0.0])
        )
    if isinstance(joint, RevoluteJoint):
        kind, axis = "revolute", joint.revolute_axis()
    elif isinstance(joint, PrismaticJoint):
        kind, axis = "prismatic", joint.translation_axis()
    else:
        raise HandFileError(
            f"{source}: joint {joint.name()!r} is of the type {joint.type_name()!r}; only revolute, prismatic and "
            "fixed joints can be imported"
        )
    lower, upper = float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])
    if kind == "revolute" and not np.isfinite([lower, upper]).any():
        kind = "continuous"
    effort = efforts.get(joint.name(), np.inf)
    return FileJoint(
        joint.name(),
        kind,
        *ends,
        X_PJ.translation(),
        X_PJ.rotation().matrix(),
        axis,
        lower,
        upper,
        effort if np.isfinite(effort) else None,
        mimics.get(joint.name()),
        joint.name() in efforts if efforts else None,
    )


def _link(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector | None,
    body: RigidBody,
    X_LB: RigidTransform,
    notes: list[str],
) -> FileLink:
    visual = collision = ()
    if inspector is not None:
        visual = _shapes(inspector, plant.GetVisualGeometriesForBody(body), X_LB, body.name(), notes)
        collision = _shapes(inspector, plant.GetCollisionGeometriesForBody(body), X_LB, body.name(), notes)
    spatial = body.default_spatial_inertia()
    mass, inertia = spatial.get_mass(), None
    if np.isfinite(mass) and mass > 0.0:
        p_BBcm, R_LB = spatial.get_com(), X_LB.rotation().matrix()
        I_BBcm = spatial.Shift(p_BBcm).CalcRotationalInertia().CopyToFullMatrix3()
        inertia = FileInertia(mass, X_LB @ p_BBcm, R_LB @ I_BBcm @ R_LB.T)
    return FileLink(body.name(), visual, collision, inertia)


def _shapes(
    inspector: SceneGraphInspector, ids: list[GeometryId], X_LB: RigidTransform, body: str, notes: list[str]
) -> tuple[FileGeometry, ...]:
    shapes = (_shape(inspector.GetShape(k), X_LB @ inspector.GetPoseInFrame(k), body, notes) for k in ids)
    return tuple(shape for shape in shapes if shape is not None)


def _shape(shape: Shape, X_LG: RigidTransform, body: str, notes: list[str]) -> FileGeometry | None:
    p, R = X_LG.translation(), X_LG.rotation().matrix()
    if isinstance(shape, DrakeSphere):
        return Sphere(p, shape.radius())
    if isinstance(shape, DrakeBox):
        return Box(shape.size(), p, R)
    if isinstance(shape, DrakeCapsule | DrakeCylinder):
        half = 0.5 * shape.length() * R[:, 2]
        return (Capsule if isinstance(shape, DrakeCapsule) else Cylinder)(p - half, p + half, shape.radius())
    if isinstance(shape, DrakeEllipsoid):
        return placed(ellipsoid(np.array([shape.a(), shape.b(), shape.c()])), R, p)
    if isinstance(shape, DrakeConvex):
        return placed(_hull(shape), R, p)
    if isinstance(shape, DrakeMesh):
        try:
            return placed(_mesh(shape), R, p)
        except HandFileError as error:
            notes.append(f"body {body!r}: {error}")
            return None
    notes.append(f"body {body!r}: a {type(shape).__name__} is left out")
    return None


def _hull(shape: DrakeConvex | DrakeMesh) -> TriangleMesh:
    hull = shape.GetConvexHull()
    vertices = np.array([hull.vertex(k) for k in range(hull.num_vertices())])
    mesh = trimesh.convex.convex_hull(vertices)
    return TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64), "convex hull")


def _mesh(shape: DrakeMesh) -> TriangleMesh:
    """A mesh from its file; its convex hull where it has none."""
    if not shape.source().is_path():
        return _hull(shape)
    path = Path(shape.source().path())
    vertices, faces = read_triangles(path, HandFileError, max_bytes=MAX_BYTES)
    scale = shape.scale3()
    if np.prod(scale) < 0.0:
        faces = faces[:, ::-1]
    return TriangleMesh(vertices * scale, np.ascontiguousarray(faces), path.name)


def _filtered(
    plant: MultibodyPlant, inspector: SceneGraphInspector, bodies: list[RigidBody], names: set[str]
) -> Iterable[tuple[str, str]]:
    """Pairs of bodies whose geometries may all not collide."""
    ids = [(body.name(), plant.GetCollisionGeometriesForBody(body)) for body in bodies if body.name() in names]
    ids = [(name, geometries) for name, geometries in ids if geometries]
    for k, (first, first_ids) in enumerate(ids):
        for second, second_ids in ids[k + 1 :]:
            if all(inspector.CollisionFiltered(i, j) for i in first_ids for j in second_ids):
                yield first, second
