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
        object: Name of a shape of the library, or the path of a mesh.
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


def _write_obj(path: Path, vertices: object, faces: object) -> None:
    import numpy as np

    from xdex_drake.cli.show import write_text

    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(vertices)]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(faces) + 1]
    write_text(path, "\n".join(lines) + "\n")
