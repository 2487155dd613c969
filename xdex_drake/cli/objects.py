"""`xdex object ...`: the objects."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from xdex_drake.cli.output import check_writable, facts, keeping_finished_work, progress, table

ObjectName = Annotated[str, tyro.conf.arg(metavar="OBJECT")]


@dataclass(frozen=True)
class ObjectList:
    """The shapes of the library.

    They are built in code, so that nothing needs to be fetched. Any mesh file works as well: give its path.
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
        return 0


@dataclass(frozen=True)
class ObjectShow:
    """One object: size, mass, convex parts, and how well they follow the mesh.

    The first time prepares the object, which can take seconds; the result is kept in a cache.
    Try `xdex object show mug`, or `xdex object show part.stl --scale 0.001` for a mesh in millimetres.

    Attributes:
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        scale: Factor from the mesh file's unit to metres.
    """

    object: tyro.conf.Positional[ObjectName]
    scale: float = 1.0

    def run(self) -> int:
        """Prints a table."""
        import numpy as np

        from xdex_drake.scene.object import load_object

        model = load_object(self.object, scale=self.scale)
        report = model.report
        print(
            facts(
                [
                    ("object", model.name),
                    ("size [cm]", " x ".join(f"{100.0 * s:.1f}" for s in np.ptp(model.vertices, axis=0))),
                    ("vertices, triangles", f"{len(model.vertices)}, {len(model.faces)}"),
                    ("closed", report.watertight),
                    ("mass [kg]", model.mass),
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
        return 0


@dataclass(frozen=True)
class ObjectImport:
    """Checks mesh files, cleans and scales them, and writes them as OBJ in metres.

    Each file is prepared at once, so that later commands find its convex parts in the cache.
    Try `xdex object import scans/*.stl --scale 0.001 --out objects`, then `xdex grasp --object objects/cup.obj ...`.

    Attributes:
        meshes: Mesh files: .obj, .stl, .ply, .off, .gltf, .glb or .dae.
        out: Folder for the cleaned meshes.
        scale: Factor from the files' unit to metres.
    """

    meshes: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="MESH...")]]
    out: Path = Path("objects")
    scale: float = 1.0

    def run(self) -> int:
        """Imports the files one by one; files that cannot be used are told, and the others are still written."""
        from xdex_drake.errors import ConfigError, XdexError
        from xdex_drake.scene.object import load_object

        if not self.meshes:
            raise ConfigError("no mesh is given; name at least one file")
        check_writable(self.out / "x.obj")
        rows: list[tuple[object, ...]] = []
        refused: list[str] = []
        with keeping_finished_work() as interruption, progress(len(self.meshes), "import") as bar:
            for path in self.meshes:
                try:
                    model = load_object(Path(path), scale=self.scale)
                except XdexError as error:
                    refused.append(str(error))
                else:
                    target = self.out / f"{model.name}.obj"
                    _write_obj(target, model.vertices, model.faces)
                    report = model.report
                    rows.append((model.name, report.parts, 1e3 * report.bulge_p99_m, report.seconds, str(target)))
                bar.update()
        if rows:
            print(table(rows, ("object", "parts", "bulge p99 [mm]", "seconds", "file")))
        if refused:
            raise ConfigError(" | ".join(refused))
        return interruption.status(0)


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
        import numpy as np
        import trimesh
        from PIL import Image

        from xdex_drake.errors import ConfigError, MissingExtra
        from xdex_drake.scene.generator import family_name, generated_mesh, shape_name
        from xdex_drake.scene.object import load_object
        from xdex_drake.visualization.pictures import contact_sheet
        from xdex_drake.visualization.shapes import render_shape

        if not 1 <= self.count <= 100_000 or not 0 <= self.seed < 1_000_000_000:
            raise ConfigError("--count must be from 1 to 100000, and --seed from 0 to 999999999")
        check_writable(self.out / "index.csv")
        lines, pictures, labels, families = ["name,family,x_m,y_m,z_m,volume_m3,triangles"], [], [], {}
        with keeping_finished_work() as interruption, progress(self.count, "generate") as bar:
            for index in range(self.count):
                name = shape_name(self.seed, index)
                family = family_name(name)
                vertices, faces = generated_mesh(name)
                _write_obj(self.out / f"{name}.obj", vertices, faces)
                x, y, z = np.ptp(vertices, axis=0)
                volume = float(trimesh.Trimesh(vertices, faces, process=False).volume)
                lines.append(f"{name},{family},{x:.6f},{y:.6f},{z:.6f},{volume:.9f},{len(faces)}")
                families[family] = families.get(family, 0) + 1
                if self.prepare:
                    load_object(name)
                if len(pictures) < 400:
                    try:
                        pictures.append(render_shape(vertices, faces))
                        labels.append(name)
                    except MissingExtra:
                        pass
                bar.update()
        from xdex_drake.cli.show import write_text

        write_text(self.out / "index.csv", "\n".join(lines) + "\n")
        if pictures:
            Image.fromarray(contact_sheet(pictures, labels, columns=16)).save(self.out / "shapes.png")
        print(table(list(families.items()), ("family", "shapes")))
        picture = f", picture {self.out / 'shapes.png'}" if pictures else ", no picture: this machine cannot render"
        print(f"{len(lines) - 1} written to {self.out}{picture}")
        return interruption.status(0)


def _write_obj(path: Path, vertices: object, faces: object) -> None:
    import numpy as np

    from xdex_drake.cli.show import write_text

    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(vertices)]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(faces) + 1]
    write_text(path, "\n".join(lines) + "\n")
