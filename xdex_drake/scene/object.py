"""The object value: a mesh, its convex parts, its distance, its mass."""

import difflib
import logging
import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.cache import cache_folder
from xdex_drake.errors import ObjectFileError, UnknownObject
from xdex_drake.scene.convex_parts import convex_parts, mesh_digest, read_cache, write_cache
from xdex_drake.scene.distance import DistanceGrid, ExactDistance, Part, build_grid, sample_surface
from xdex_drake.scene.generator import generated_mesh, is_shape_name
from xdex_drake.scene.hulls import convex_hull
from xdex_drake.scene.mesh import TriangleMesh, body_of_path, check_scale, clean_mesh, read_mesh
from xdex_drake.scene.procedural import box_mesh, box_sides, list_objects, procedural_mesh

Faces = NDArray[np.int64]
_log = logging.getLogger(__name__)

GRID_RECIPE = 3  # Raise whenever the way to the grid changes: it is part of the cache's key.
LIKELY_BODIES = 30
"""A mesh of more bodies is hardly one of an object: its split gets less time."""

LIKELY_WALL = 2e-3
"""Least mean thickness, 2 volume / area, of a likely closed mesh [sizes]; one that runs through itself has less."""

LIKELY_FOLDS = 3.0
"""Greatest area of a likely mesh [areas of its convex hull]: 240 everyday and generated ones had at most 1.9."""

FAR_AWAY = 100.0
"""Distance from its origin from which on a mesh is worked on near it [sizes]."""

DEFAULT_MASS = 0.1
DEFAULT_FRICTION = 0.6


@dataclass(frozen=True)
class PreparationReport:
    """What preparing an object did and how good the result is.

    Attributes:
        seconds: Time of the convex decomposition [s]; that of the first time where it comes from the cache.
        cached: Whether the parts come from the cache.
        parts: Number of convex parts.
        bulge_p99_m: 99th percentile of the distance by which the parts stand out of the mesh [m].
        gap_p99_m: 99th percentile of the distance by which the mesh stands out of the parts [m].
        repairs: What was changed in the mesh, in words.
        watertight: Whether the mesh is closed.
        inertia_source: `mesh`, or `parts` where the mesh is not closed, or overlaps itself, and the volume of the
            parts is taken.
        volume: Volume of the material [m^3]: without the inside of a cup.
        wall: Mean thickness of the walls of a shell, such as a cup or a frame [m]; None for a solid body. A shell
            encloses less than half of its convex hull by walls, 2 volume / area, thinner than 0.12 times its size.
    """

    seconds: float
    cached: bool
    parts: int
    bulge_p99_m: float
    gap_p99_m: float
    repairs: tuple[str, ...]
    watertight: bool
    inertia_source: str
    volume: float = float("nan")
    wall: float | None = None


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object, in its own frame O: that of the mesh file, scaled.

    Attributes:
        name: Name.
        path: The mesh file, None for a shape of the library.
        vertices: Vertices of the mesh [m], shape (n, 3).
        faces: Outward triangles of the mesh, shape (m, 3).
        parts: Convex parts: vertices (n, 3) [m] and outward faces (m, 3) of each.
        surface: Vertices (n, 3) [m] and outward faces (m, 3) of the union of the parts: the surface of contacts.
        mass: Mass [kg].
        p_OOcm: Center of mass [m], shape (3,).
        I_OcmO: Rotational inertia about the center of mass, in O [kg m^2], shape (3, 3); uniform density.
        friction: Coefficient of friction.
        scale: Factor from the mesh file's unit to metres.
        length: Length that divides torques [m]: root mean square distance of the surface from the center of mass.
        digest: SHA-256 of the scaled mesh.
        report: How the object was prepared.
        inertia_given: Whether center of mass or inertia are not those of the volume.
    """

    name: str
    path: Path | None
    vertices: Array = field(repr=False)
    faces: Faces = field(repr=False)
    parts: tuple[Part, ...] = field(repr=False)
    surface: Part = field(repr=False)
    mass: float
    p_OOcm: Array
    I_OcmO: Array = field(repr=False)
    friction: float
    scale: float
    length: float
    digest: str
    report: PreparationReport
    inertia_given: bool = False

    def __repr__(self) -> str:
        """One line."""
        size = " x ".join(f"{100.0 * length:.1f}" for length in np.ptp(self.vertices, axis=0))
        return f"ObjectModel({self.name!r}, {size} cm, {self.mass:.3g} kg, {len(self.parts)} convex parts)"

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone, for another process: what is computed from them on demand cannot all be copied."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @cached_property
    def exact(self) -> ExactDistance:
        """Exact signed distance to the union of the convex parts."""
        return ExactDistance(*self.surface, parts=self.parts)

    @cached_property
    def mesh_distance(self) -> ExactDistance:
        """Exact signed distance to the mesh itself; the sign by winding number."""
        return ExactDistance(self.vertices, self.faces)

    @cached_property
    def grid(self) -> DistanceGrid:
        """Signed distance to the union of the convex parts on a grid, kept in the cache."""
        digest = mesh_digest(*self.surface)
        file = cache_folder() / f"grid-{GRID_RECIPE}-{digest[:32]}.npz"
        if (arrays := read_cache(file)) is not None:
            try:
                values, gradients = arrays["values"], arrays["gradients"]
                if gradients.shape == (*values.shape, 3) and values.ndim == 3:
                    return DistanceGrid(values, gradients, arrays["origin"], float(arrays["spacing"]))
            except (KeyError, ValueError, TypeError):
                pass
            _log.warning("%s is damaged and is computed again", file)
        grid = build_grid(self.exact)
        arrays = {"values": grid.values, "gradients": grid.gradients, "origin": grid.origin}
        write_cache(file, arrays | {"spacing": np.array(grid.spacing)})
        return grid

    def surface_samples(self, n: int, seed: int = 0) -> tuple[Array, Array]:
        """Points spread evenly at random over the union of the convex parts.

        Args:
            n: Number of points.
            seed: Seed of the sampling.

        Returns:
            Points in O [m], shape (n, 3), and unit normals out of the object, shape (n, 3).
        """
        points, face = sample_surface(*self.surface, n, seed)
        return points, self.exact.normals[face]


def load_object(
    name_or_path: str | Path | trimesh.Trimesh | tuple[Array, Faces],
    *,
    name: str = "",
    scale: float | None = None,
    mass: float = DEFAULT_MASS,
    friction: float = DEFAULT_FRICTION,
    density: float | None = None,
    p_OOcm: tuple[float, float, float] | Array | None = None,
    I_OcmO: Array | None = None,
) -> ObjectModel:
    """Prepares an object: a shape of the library, a generated shape, any mesh file, or a mesh in memory.

    Mass is given, and spread evenly over the volume. By a density it is that of the mesh's own volume: of its walls
    where they are part of the mesh, as those of a cup, or of a wall of 2 mm where the surface is open. Where the mass
    lies otherwise, center of mass and inertia are given too.

    Args:
        name_or_path: One of `list_objects()`, the name of a generated shape (`s0-0042`: seed 0, number 42), the sides
            of a box (`0.06x0.06x0.12`, in metres), or the path of a mesh file. A `trimesh.Trimesh`, or vertices (n, 3)
            and triangles (m, 3), are a mesh in memory; grasps of it can be stored only once it has a file.
        name: Name of a mesh in memory; of others it is theirs.
        scale: Factor from the mesh file's unit to metres; guessed by the size of a mesh file where None.
        mass: Mass [kg]; unused where `density` is given.
        friction: Coefficient of friction.
        density: Density [kg/m^3], None for the mass as given.
        p_OOcm: Center of mass in O [m], shape (3,); that of the volume where None.
        I_OcmO: Rotational inertia about the center of mass, in O [kg m^2], shape (3, 3); that of the volume where None.

    Returns:
        The object, with its convex parts.

    Raises:
        UnknownObject: The library has no such shape.
        ObjectFileError: The mesh file or a number cannot be used.
    """
    for label, value in (("mass", mass), ("density", density)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise ObjectFileError(f"{name_or_path}: {label} is {value}; give a finite number greater than zero")
    if not (math.isfinite(friction) and friction >= 0.0):
        raise ObjectFileError(f"{name_or_path}: friction is {friction}; give a finite number, zero or greater")
    if isinstance(name_or_path, str | Path):
        called, path, mesh = object_mesh(name_or_path, scale=scale)
    else:
        called, path, mesh = name or "mesh", None, _mesh_in_memory(name_or_path, scale, name or "mesh")
        name_or_path = called
    given = _checked_inertia(called, p_OOcm, I_OcmO)
    # Far from its origin a surface is worked on near it: volume and inertia would be differences of huge numbers.
    offset = _far_center(mesh.vertices)
    mesh = replace(mesh, vertices=mesh.vertices - offset)
    try:
        convex = convex_parts(mesh.vertices, mesh.faces, likely=_is_likely(mesh))
    except ObjectFileError as error:
        raise ObjectFileError(f"{name_or_path}: {error}") from None
    body, source = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), "mesh"
    union = trimesh.Trimesh(*convex.surface, process=False)
    repairs = [*mesh.repairs, *([convex.note] if convex.note else [])]
    if mesh.watertight and body.volume > 1.02 * union.volume:
        repairs.append("the surface overlaps itself: volume and inertia are those of the parts")
        body, source = union, "parts"
    elif not (mesh.watertight and body.volume > 0.0):
        body, source = union, "parts"
    properties = body.mass_properties
    volume = float(properties.mass)
    if density is not None:
        mass = density * volume
    wall = 2.0 * volume / float(body.area)
    hull = float(body.convex_hull.volume)
    center = np.asarray(properties.center_mass, dtype=np.float64) if given[0] is None else given[0] - offset
    inertia = np.asarray(properties.inertia, dtype=np.float64) * (mass / properties.mass)
    report = PreparationReport(
        seconds=convex.seconds,
        cached=convex.cached,
        parts=len(convex.parts),
        bulge_p99_m=convex.bulge_p99_m,
        gap_p99_m=convex.gap_p99_m,
        repairs=tuple(repairs),
        watertight=mesh.watertight,
        inertia_source=source,
        volume=volume,
        wall=wall if mesh.shell or (volume < 0.5 * hull and wall < 0.12 * hull ** (1.0 / 3.0)) else None,
    )
    return ObjectModel(
        name=called,
        path=path,
        vertices=mesh.vertices + offset,
        faces=mesh.faces,
        parts=tuple((vertices + offset, faces) for vertices, faces in convex.parts),
        surface=(convex.surface[0] + offset, convex.surface[1]),
        mass=mass,
        p_OOcm=center + offset,
        I_OcmO=inertia if given[1] is None else given[1],
        friction=friction,
        scale=mesh.scale,
        length=_surface_radius(*convex.surface, center),
        digest=mesh_digest(mesh.vertices + offset, mesh.faces),
        report=report,
        inertia_given=any(values is not None for values in given),
    )


def _mesh_in_memory(mesh: trimesh.Trimesh | tuple[Array, Faces], scale: float | None, name: str) -> TriangleMesh:
    """The clean mesh of arrays, which are in metres unless a scale says otherwise."""
    check_scale(scale, name)
    vertices, faces = (mesh.vertices, mesh.faces) if isinstance(mesh, trimesh.Trimesh) else mesh
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ObjectFileError(
            f"{name}: vertices have shape {vertices.shape} and faces {faces.shape}; give (n, 3) and (m, 3)"
        )
    if not np.issubdtype(faces.dtype, np.integer):
        raise ObjectFileError(f"{name}: faces are of type {faces.dtype}; give whole numbers, indices of vertices")
    try:
        return replace(clean_mesh(vertices * (scale or 1.0), faces.astype(np.int64)), scale=scale or 1.0)
    except ObjectFileError as error:
        raise ObjectFileError(f"{name}: {error}") from None


def _checked_inertia(
    name: str, p_OOcm: tuple[float, float, float] | Array | None, I_OcmO: Array | None
) -> tuple[Array | None, Array | None]:
    """A center of mass and an inertia that a body can have."""
    center = None if p_OOcm is None else np.asarray(p_OOcm, dtype=np.float64)
    if center is not None and (center.shape != (3,) or not np.isfinite(center).all()):
        raise ObjectFileError(f"{name}: p_OOcm is {p_OOcm}; give three finite numbers")
    if I_OcmO is None:
        return center, None
    inertia = np.asarray(I_OcmO, dtype=np.float64)
    moments = np.linalg.eigvalsh(inertia) if inertia.shape == (3, 3) and np.isfinite(inertia).all() else np.zeros(3)
    sound = np.allclose(inertia, inertia.T) and moments[0] > 0.0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-9)
    if inertia.shape != (3, 3) or not sound:
        raise ObjectFileError(
            f"{name}: I_OcmO is the inertia of no body; give a symmetric (3, 3) in kg m^2 whose moments are positive, "
            "none above the sum of the others"
        )
    return center, inertia


def object_mesh(name_or_path: str | Path, *, scale: float | None = None) -> tuple[str, Path | None, TriangleMesh]:
    """The clean mesh of an object, which takes little of the time that its convex parts take.

    Args:
        name_or_path: See `load_object`.
        scale: See `load_object`.

    Returns:
        Name of the object, the file where there is one, and the mesh, scaled.

    Raises:
        UnknownObject: The library has no such shape.
        ObjectFileError: The mesh file cannot be used.
    """
    check_object_name(name_or_path)
    text = str(name_or_path)
    if isinstance(name_or_path, str) and (built := _built(text)) is not None:
        check_scale(scale, text)
        return text, None, replace(clean_mesh(built[0] * (scale or 1.0), built[1]), scale=scale or 1.0)
    path = Path(name_or_path)
    mesh = read_mesh(path, scale=scale)
    return _name_of(path), path, mesh


def _built(name: str) -> tuple[Array, Faces] | None:
    """Vertices and faces of what is built in code by its name; None for other names."""
    if name in list_objects():
        return procedural_mesh(name)
    if is_shape_name(name):
        return generated_mesh(name)
    sides = box_sides(name)
    return None if sides is None else box_mesh(sides)


def is_built(name: str) -> bool:
    """Whether a name alone stands for an object."""
    return name in list_objects() or is_shape_name(name) or box_sides(name) is not None


def check_object_name(name_or_path: str | Path) -> None:
    """Refuses a name that is none; whether a path is one of a mesh is seen when it is read.

    Args:
        name_or_path: See `load_object`.

    Raises:
        UnknownObject: The library has no such shape.
    """
    text, known = str(name_or_path), list_objects()
    if not isinstance(name_or_path, str) or "/" in text or "\\" in text or Path(text).suffix or box_sides(text):
        return
    if text not in known and not is_shape_name(text):
        close = difflib.get_close_matches(text, known, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(known)}"
        raise UnknownObject(f"no object is named {text!r}; {hint} (a mesh is given by the path of its file)")


def _name_of(path: Path) -> str:
    """Name of the object of a path: that of the file, and the number of its body where one is chosen."""
    file, body = body_of_path(path)
    return file.stem if body is None else f"{file.stem}_{body}"


def _far_center(vertices: Array) -> Array:
    """Center of the box around a mesh that lies more than `FAR_AWAY` of its sizes from its origin; else zero."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    center = 0.5 * (low + high)
    return center if np.linalg.norm(center) > FAR_AWAY * np.linalg.norm(high - low) else np.zeros(3)


def _is_likely(mesh: TriangleMesh) -> bool:
    """Whether a mesh looks like one of an object: few bodies, few folds and, if it is closed, something inside."""
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    hollow = mesh.watertight and 2.0 * body.volume < LIKELY_WALL * float(
        body.area * np.ptp(mesh.vertices, axis=0).max()
    )
    if mesh.bodies > LIKELY_BODIES or hollow:
        return False
    hull = convex_hull(np.asarray(mesh.vertices))
    return float(body.area) <= LIKELY_FOLDS * float(trimesh.Trimesh(*hull, process=False).area)


def _surface_radius(vertices: Array, faces: Faces, center: Array) -> float:
    """Root mean square distance of a surface from a point, integrated exactly over its triangles."""
    corners = vertices[faces] - center
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    square = ((corners**2).sum(axis=(1, 2)) + (corners.sum(axis=1) ** 2).sum(axis=1)) / 12.0
    return float(math.sqrt((area * square).sum() / area.sum()))
