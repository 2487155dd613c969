"""Reads SDFormat files by Drake's parser, in a process of its own: some files end the process that parses them.

Before that the file is read as plain XML, within limits; meshes are read here, from the hand's folder only, and given
to the parser as OBJ files, so that formats and paths that Drake does not take are no hindrance.
"""

import logging
import pickle
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.importing.mesh_files import Allowed, MeshFiles, MissingMesh, notes_of_lost
from xdex_drake.hand.importing.model import FileGeometry, FileLink, FileMimic, FileModel, TriangleMesh
from xdex_drake.hand.importing.tree import check_mimics
from xdex_drake.hand.importing.xml_file import MAX_LINKS, Element, read_xml

WHAT = "an SDFormat file of one hand"
TIME_LIMIT = 60.0
"""Longest time that Drake's parser may take [s]."""

UNSUPPORTED = ("include", "actor", "population", "road", "heightmap", "polyline", "image")


def read_sdf(path: str | Path, allowed: Allowed | None = None) -> FileModel:
    """Reads an SDFormat file that holds one model.

    Args:
        path: The file.
        allowed: What may be read besides the hand's folder.

    Returns:
        The robot as the file has it.

    Raises:
        HandFileError: The file is not an SDFormat file, holds no or several models, is refused by Drake's parser, or
            leads out of the hand's folder; the message names file, element and remedy.
    """
    path = Path(path)
    root = read_xml(path, WHAT)
    if root.tag != "sdf":
        raise HandFileError(f"{path}: its root element is <{root.tag[:40]}>, not <sdf>; give {WHAT}")
    meshes = MeshFiles(path, allowed)
    lost: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory(prefix="xdex-sdf-") as folder:
        _check(root, path)
        names = _localize_meshes(root, meshes, Path(folder), lost)
        copy = Path(folder) / "hand.sdf"
        ElementTree.ElementTree(root).write(copy, encoding="utf-8", xml_declaration=True)
        model = _parse_apart(copy, path)
    links = _renamed(model, names, lost)
    laws = _mimics(root, str(path))
    joints = tuple(replace(joint, mimic=joint.mimic or laws.get(joint.name)) for joint in model.joints)
    check_mimics(joints, str(path))
    return FileModel(
        model.name,
        str(path),
        links,
        joints,
        model.ignored_pairs,
        (*model.notes, *notes_of_lost(links)),
        meshes.decisions,
    )


def _check(root: Element, path: Path) -> None:
    """Refuses what would end Drake's process, and what would lead to other files."""
    source = str(path)
    links = sum(1 for _ in root.iter("link"))
    if links == 0:
        raise HandFileError(f"{source}: has no links; give {WHAT}")
    if links > MAX_LINKS:
        raise HandFileError(f"{source}: has {links} links, more than {MAX_LINKS}; give a file of the hand alone")
    for element in root.iter():
        if element.tag in UNSUPPORTED:
            raise HandFileError(f"{source}: uses <{element.tag}>, which is not read; write the model out in one file")
        text = (element.text or "").strip().lower()
        for word in text.split():
            if word.lstrip("+-").startswith("nan"):
                raise HandFileError(f"{source}: <{element.tag[:40]}> holds {word[:20]!r}; write a finite number")
    for joint in root.iter("joint"):
        for axis in (*joint.findall("axis"), *joint.findall("axis2")):
            limit = axis.find("limit")
            if limit is None:
                continue
            place = f"joint {joint.get('name')!r}"
            lower, upper = (_number(limit, tag, default, source, place) for tag, default in _LIMITS)
            if lower > upper:
                raise HandFileError(f"{source}: {place} has lower {lower:g} above upper {upper:g}; exchange them")


_LIMITS = (("lower", -np.inf), ("upper", np.inf))


def _number(element: Element, tag: str, default: float, source: str, place: str) -> float:
    text = element.findtext(tag)
    try:
        return default if text is None else float(text)
    except ValueError:
        raise HandFileError(f"{source}: {place} has <{tag}> {text!r:.40}; write a number") from None


def _mimics(root: Element, source: str) -> dict[str, FileMimic]:
    """SDFormat's own laws, q = multiplier (q_leader - reference) + offset, which Drake's parser passes over."""
    laws = {}
    for joint in root.iter("joint"):
        if (law := joint.find("axis/mimic")) is not None:
            place = f"the <mimic> of joint {joint.get('name')!r}"
            defaults = (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
            slope, offset, reference = (_number(law, tag, default, source, place) for tag, default in defaults)
            laws[joint.get("name", "")] = FileMimic(law.get("joint", ""), slope, offset - slope * reference)
    return laws


def _localize_meshes(root: Element, meshes: MeshFiles, folder: Path, lost: dict[str, list[str]]) -> dict[str, str]:
    """Lets each mesh element refer to an OBJ file in `folder`, removes shapes whose mesh is missing.

    Returns:
        Name of the mesh's own file by that of the OBJ file.
    """
    written: dict[tuple[Path, str], str] = {}
    for link in root.iter("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            part[:] = [child for child in part if child.tag != "material"]  # Scripts and textures are files, too.
            for element in list(part.iter("mesh")):
                uri, scale = (element.findtext("uri") or "").strip(), element.findtext("scale") or "1 1 1"
                try:
                    file = meshes.locate(uri)
                    if (file, scale) not in written:
                        target = folder / f"mesh_{len(written)}.obj"
                        _write_obj(meshes.read(uri, _scale(scale, str(meshes.path))), target)
                        written[file, scale] = target.name
                except MissingMesh as cause:
                    lost.setdefault(link.get("name", ""), []).append(str(cause))
                    link.remove(part)
                    break
                entry = element.find("uri")
                assert entry is not None
                entry.text = written[file, scale]
                element[:] = [child for child in element if child.tag != "scale"]
    for element in root.iter():
        if element.tag in ("uri", "filename") and not (element.text or "").startswith("mesh_"):
            element.text = ""
    for parent in list(root.iter()):
        parent[:] = [child for child in parent if child.tag not in ("plugin", "sensor")]
    return {target: file.name for (file, _), target in written.items()}


def _scale(text: str, source: str) -> Array:
    try:
        scale = np.array([float(word) for word in text.split()])
    except ValueError:
        scale = np.zeros(0)
    if len(scale) not in (1, 3) or not np.isfinite(scale).all():
        raise HandFileError(f"{source}: a <mesh> has the scale {text!r:.60}; give three numbers")
    return np.ones(3) * scale


def _write_obj(mesh: TriangleMesh, file: Path) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    file.write_text("\n".join(lines) + "\n", encoding="ascii")


def _renamed(model: FileModel, names: dict[str, str], lost: dict[str, list[str]]) -> tuple[FileLink, ...]:
    """The links with the names of their meshes' own files, and with what they lack."""

    def rename(shape: FileGeometry) -> FileGeometry:
        if isinstance(shape, TriangleMesh):
            return TriangleMesh(shape.vertices, shape.faces, names.get(shape.source, shape.source))
        return shape

    return tuple(
        FileLink(
            link.name,
            tuple(map(rename, link.visual)),
            tuple(map(rename, link.collision)),
            link.inertia,
            tuple(dict.fromkeys(lost.get(link.name, ()))),
        )
        for link in model.links
    )


def _parse_apart(copy: Path, path: Path) -> FileModel:
    command = [sys.executable, "-m", "xdex_drake.hand.importing.sdformat", str(copy)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIME_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        raise HandFileError(f"{path}: took longer than {TIME_LIMIT:g} s to parse; simplify the file") from None
    if done.returncode != 0 or not done.stdout:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        reason = said[-1].replace(str(copy), "")[:200] if said else f"it ended with status {done.returncode}"
        raise HandFileError(f"{path}: Drake's parser fails on it ({reason}); mend the file, or give a URDF")
    answer = pickle.loads(done.stdout)
    if isinstance(answer, FileModel):
        return answer
    said = " ".join(str(answer).replace(str(copy), "").split())[:300]
    raise HandFileError(f"{path}: Drake's parser refuses it ({said}); mend that, or give a URDF")


def _main(copy: str) -> None:
    """In the process of its own: parses the prepared file and writes the model, or what is wrong, to the output."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.systems.framework import DiagramBuilder

    from xdex_drake.hand.importing.drake_plant import model_from_plant

    logging.getLogger("drake").setLevel(logging.ERROR)
    try:
        # Couplings exist in discrete plants only.
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
        instances = Parser(plant).AddModels(Path(copy))
        if len(instances) != 1:
            raise HandFileError(f"it holds {len(instances)} models, not one")
        plant.Finalize()
        answer: object = model_from_plant(plant, instances[0], scene_graph=scene_graph)
    except (HandFileError, RuntimeError, ValueError) as error:
        answer = str(error)
    sys.stdout.buffer.write(pickle.dumps(answer))


if __name__ == "__main__":
    _main(sys.argv[1])
