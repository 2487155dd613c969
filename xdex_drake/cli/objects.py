"""`xdex object ...`: the objects."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from xdex_drake.cli.output import check_writable, facts, keeping_finished_work, progress, table, tell_repairs

if TYPE_CHECKING:
    from pydrake.math import RigidTransform

    from xdex_drake.scene.object import PreparationReport

ObjectName = Annotated[str, tyro.conf.arg(metavar="OBJECT")]


@dataclass(frozen=True)
class ObjectList:
    """The shapes of the library.

    They are built in code, so that nothing needs to be fetched. Any mesh file works as well: give its path. So does the
    name of a generated shape: s0-0042 is number 42 of seed 0, and so on without end.
    """

    def run(self) -> int:
        """Prints one line a shape."""
        import numpy as np

        from xdex_drake.scene.procedural import list_objects, procedural_mesh

        rows = []
        for name in list_objects():
            vertices, faces = procedural_mesh(name)
            size = " x ".join(f"{100.0 * length:.1f}" for length in np.ptp(vertices, axis=0))
            rows.append((name, size, len(faces)))
        print(table(rows, ("object", "size [cm]", "triangles")))
        print("and generated shapes without end, by names such as s0-0042 (seed 0, number 42): `xdex object generate`")
        return 0


@dataclass(frozen=True)
class ObjectShow:
    """One object: size, mass, convex parts and how well they follow the mesh, and the poses in which it rests.

    The first time prepares the object, which can take seconds; the result is kept in a cache.
    Try `xdex object show mug`, or `xdex object show part.stl --scale 0.001` for a mesh in millimetres.

    Attributes:
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        scale: Factor from the mesh file's unit to metres; guessed by the size, and told, where not given.
        mass: Mass [kg].
        density: Density [kg/m^3] of the material, that of the walls of a cup; instead of the mass.
        poses: Also drop the object and print the poses in which it rests, with their probabilities.
    """

    object: tyro.conf.Positional[ObjectName]
    scale: float | None = None
    mass: float = 0.1
    density: float | None = None
    poses: bool = True

    def run(self) -> int:
        """Prints a table."""
        import numpy as np

        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import stable_poses

        model = load_object(self.object, scale=self.scale, mass=self.mass, density=self.density)
        report = model.report
        print(
            facts(
                [
                    ("object", model.name),
                    ("size [cm]", " x ".join(f"{100.0 * s:.1f}" for s in np.ptp(model.vertices, axis=0))),
                    ("vertices, triangles", f"{len(model.vertices)}, {len(model.faces)}"),
                    ("closed", report.watertight),
                    ("scale", model.scale),
                    ("walls [mm]", "solid" if report.wall is None else f"shell, {1e3 * report.wall:.2g} on average"),
                    ("volume [cm^3]", f"{1e6 * report.volume:.4g} of material, by the {report.inertia_source}"),
                    ("mass [kg]", f"{model.mass:.4g} ({'given' if self.density is None else 'density x volume'})"),
                    ("density [kg/m^3]", model.mass / report.volume),
                    ("friction", model.friction),
                    ("center of mass [m]", ", ".join(f"{x:.4f}" for x in model.p_OOcm)),
                    ("length of torques [m]", model.length),
                    ("convex parts", report.parts),
                    ("bulge p99 [mm]", 1e3 * report.bulge_p99_m),
                    ("gap p99 [mm]", 1e3 * report.gap_p99_m),
                    ("preparation [s]", f"{report.seconds:.2f}{' (kept in the cache)' if report.cached else ''}"),
                    ("repairs", ", ".join(report.repairs) or "none"),
                    ("digest", model.digest),
                ]
            )
        )
        if self.poses:
            rows = [
                (k, f"{pose.probability:.3f}", 100.0 * float(pose.X_WO.translation()[2]), _direction(pose.X_WO))
                for k, pose in enumerate(stable_poses(model))
            ]
            print("\n" + table(rows, ("pose", "probability", "height of origin [cm]", "up, in the object's frame")))
        return 0


@dataclass(frozen=True)
class ObjectImport:
    """Checks mesh files, cleans and scales them, and writes them as OBJ in metres, with an index.

    A folder stands for the meshes in it and below. Each file is prepared at once, so that later commands find its
    convex parts in the cache; `index.csv` tells its scale, size, parts, how they fit, seconds and repairs.
    Try `xdex object import scans --out objects`, then `xdex grasp --object objects/cup.obj ...`.

    Attributes:
        meshes: Mesh files (.obj, .stl, .ply, .off, .gltf, .glb or .dae), and folders of them.
        out: Folder for the cleaned meshes and `index.csv`.
        scale: Factor from the files' unit to metres; guessed for each by its size, and told, where not given.
    """

    meshes: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="MESH...")]]
    out: Path = Path("objects")
    scale: float | None = None

    def run(self) -> int:
        """Imports the files one by one; files that cannot be used are told, and the others are still written."""
        from xdex_drake.errors import ConfigError
        from xdex_drake.jobs.meshes import import_meshes, mesh_files, write_index

        if not self.meshes:
            raise ConfigError("no mesh is given; name at least one file or folder")
        files = [file for path in self.meshes for file in mesh_files(Path(path))]
        if not files:
            raise ConfigError(
                f"{self.meshes[0]}: holds no mesh files; give a folder of .obj, .stl, .ply or other meshes"
            )
        check_writable(self.out / "x.obj")
        done = []
        with keeping_finished_work() as interruption, progress(len(files), "import") as bar:
            for mesh in import_meshes(files, self.out, scale=self.scale):
                done.append(mesh)
                bar.update()
        rows = [
            (mesh.row.name, mesh.model.scale, *_fit(mesh.model.report), str(self.out / mesh.row.file))
            for mesh in done
            if mesh.model is not None
        ]
        if rows:
            print(table(rows, ("object", "scale", "parts", "bulge p99 [mm]", "seconds", "repairs", "file")))
        if told := [remark for mesh in done for remark in mesh.remarks]:
            print("\n" + "\n".join(told))
        write_index(self.out / "index.csv", [mesh.row for mesh in done])
        if refused := [mesh.refused for mesh in done if mesh.refused]:
            raise ConfigError(" | ".join(refused))
        return interruption.status(0)


@dataclass(frozen=True)
class ObjectExport:
    """Writes an object as a URDF, SDFormat or MJCF file, for other tools.

    It shows its mesh and collides by its convex parts, which tools that take the convex hull of a mesh need; mass and
    inertia are written. Try `xdex object export mug --format sdf --out mug_sdf`.

    Attributes:
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        format: The format.
        out: Folder for the file and meshes/; NAME_FORMAT in this folder where not given.
        scale: Factor from the mesh file's unit to metres; guessed by the size where not given.
        mass: Mass [kg].
        friction: Coefficient of friction.
    """

    object: tyro.conf.Positional[ObjectName]
    format: Literal["urdf", "sdf", "mjcf"] = "urdf"
    out: Path | None = None
    scale: float | None = None
    mass: float = 0.1
    friction: float = 0.6

    def run(self) -> int:
        """Writes the files."""
        from xdex_drake.interchange.objects import export_object
        from xdex_drake.scene.object import load_object

        model = load_object(self.object, scale=self.scale, mass=self.mass, friction=self.friction)
        tell_repairs(model)
        out = self.out or Path(f"{model.name}_{self.format}")
        print(f"{model.name}: {export_object(model, out, format=self.format)}")
        return 0


@dataclass(frozen=True)
class ObjectGenerate:
    """Generated shapes: everyday-like, closed, of a size for a hand, as many as wanted.

    Each has a name, such as s0-0042 for number 42 of seed 0, by which every command builds it again without a file.
    This command writes them as OBJ in metres, with an index and a picture of all of them.
    Try `xdex object generate --count 64 --out shapes`, then `xdex grasp --hand allegro --object s0-0042`.

    Attributes:
        count: Number of shapes.
        seed: Seed of the set; another seed gives other shapes.
        out: Folder for the meshes, `index.csv` and `shapes.png`.
        prepare: Also compute the convex parts, which takes seconds a shape; later commands find them in the cache.
    """

    count: int = 200
    seed: int = 0
    out: Path = Path("shapes")
    prepare: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Builds the shapes one by one and writes them."""
        from collections import Counter

        import numpy as np
        from PIL import Image

        from xdex_drake.errors import ConfigError, MissingExtra
        from xdex_drake.jobs.meshes import write_shapes
        from xdex_drake.visualization.pictures import contact_sheet
        from xdex_drake.visualization.shapes import render_shape
        from xdex_drake.whole_file import write_text

        if not 1 <= self.count <= 100_000 or not 0 <= self.seed < 1_000_000_000:
            raise ConfigError("--count must be from 1 to 100000, and --seed from 0 to 999999999")
        check_writable(self.out / "index.csv")
        lines, pictures, labels, families = ["name,family,x_m,y_m,z_m,volume_m3,triangles"], [], [], Counter()
        with keeping_finished_work() as interruption, progress(self.count, "generate") as bar:
            for shape in write_shapes(self.count, self.seed, self.out, prepare=self.prepare):
                x, y, z = np.ptp(shape.vertices, axis=0)
                size = f"{x:.6f},{y:.6f},{z:.6f}"
                lines.append(f"{shape.name},{shape.family},{size},{shape.volume_m3:.9f},{len(shape.faces)}")
                families[shape.family] += 1
                if len(pictures) < 400:
                    try:
                        pictures.append(render_shape(shape.vertices, shape.faces))
                        labels.append(shape.name)
                    except MissingExtra:
                        pass
                bar.update()
        write_text(self.out / "index.csv", "\n".join(lines) + "\n")
        if pictures:
            Image.fromarray(contact_sheet(pictures, labels, columns=16)).save(self.out / "shapes.png")
        print(table(list(families.items()), ("family", "shapes")))
        picture = f", picture {self.out / 'shapes.png'}" if pictures else ", no picture: this machine cannot render"
        print(f"{len(lines) - 1} written to {self.out}{picture}")
        return interruption.status(0)


def _fit(report: "PreparationReport") -> tuple[int, float, float, int]:
    """Parts, bulge [mm], seconds and number of repairs."""
    return report.parts, 1e3 * report.bulge_p99_m, report.seconds, len(report.repairs)


def _direction(X_WO: "RigidTransform") -> str:
    return ", ".join(f"{x + 0.0:.2f}" for x in X_WO.rotation().matrix()[2].round(2))
