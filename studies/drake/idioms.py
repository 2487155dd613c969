"""Which ways of calling pydrake work: those that this library uses, and those that a user may.

python studies/drake/idioms.py studies/drake/idioms.csv

Run once in an environment of each version of Drake; a column is added to the file, or replaced.
"""

import copy
import csv
import pickle
import sys
import weakref
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Box, Rgba, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, DiscreteContactApproximation
from pydrake.multibody.tree import BodyIndex
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions
from pydrake.systems.framework import DiagramBuilder, LeafSystem


class Two(LeafSystem):
    """A system written in Python."""

    def __init__(self) -> None:
        LeafSystem.__init__(self)
        self.DeclareVectorOutputPort("y", 2, lambda context, output: output.SetFromVector([1, 2]))


def evaluated() -> Any:
    """Output of a Python system in a diagram."""
    builder = DiagramBuilder()
    system = builder.AddSystem(Two())
    context = builder.Build().CreateDefaultContext()
    return system.get_output_port().Eval(system.GetMyContextFromRoot(context))


def with_program(use: Callable[[MathematicalProgram, Any], Any]) -> Callable[[], Any]:
    """Something done to a program of three variables."""

    def made() -> Any:
        prog = MathematicalProgram()
        return use(prog, prog.NewContinuousVariables(3))

    return made


IDIOMS: dict[str, Callable[[], Any]] = {
    "a list of floats as a vector": lambda: RigidTransform([0.0, 0.0, 1.0]),
    "a list of ints as a vector": lambda: RigidTransform([0, 0, 1]),
    "a tuple as a vector": lambda: RigidTransform((0.0, 0.0, 1.0)),
    "an array of ints as a vector": lambda: RigidTransform(np.array([0, 0, 1])),
    "an array of float32 as a vector": lambda: RigidTransform(np.zeros(3, np.float32)),
    "a read-only array without strides": lambda: RigidTransform(np.broadcast_to(np.zeros(1), (3,))),
    "a strided matrix": lambda: RotationMatrix(np.eye(6)[::2, ::2]),
    "many points by a product": lambda: RigidTransform() @ np.zeros((3, 5)),
    "many points that are a transpose": lambda: RigidTransform() @ np.zeros((5, 3)).T,
    "an int as a number": lambda: Sphere(1),
    "a float32 as a number": lambda: Sphere(np.float32(1.0)),
    "an array without dimensions as a number": lambda: Sphere(np.array(1.0)),
    "a list of ints as a size": lambda: Box([1, 2, 3]),
    "numbers of an array as arguments": lambda: Rgba(*np.array([0.1, 0.2, 0.3, 1.0])),
    "keywords": lambda: CoulombFriction(static_friction=np.float64(0.5), dynamic_friction=0.5),
    "an index of an int64": lambda: BodyIndex(np.int64(3)),
    "an index of a float": lambda: BodyIndex(3.0),  # type: ignore[call-overload]
    "an index into a list": lambda: [1, 2, 3][BodyIndex(1)],
    "an index plus one": lambda: BodyIndex(1) + 1,  # type: ignore[operator]
    "an enumeration's name": lambda: DiscreteContactApproximation.kLagged.name,
    "an enumeration as a key": lambda: {DiscreteContactApproximation.kLagged: 1},
    "a copy": lambda: copy.copy(RigidTransform()),
    "a deep copy": lambda: copy.deepcopy(RigidTransform()),
    "a pickled pose": lambda: pickle.loads(pickle.dumps(RigidTransform([1.0, 2.0, 3.0]))),
    "pickled angles": lambda: pickle.loads(pickle.dumps(RollPitchYaw([1.0, 2.0, 3.0]))),
    "a Python function as a cost": with_program(lambda prog, x: prog.AddCost(lambda z: z @ z, x)),
    "an expression as a cost": with_program(lambda prog, x: prog.AddCost(x[0] ** 2 + x[1])),
    "bounds as lists": with_program(lambda prog, x: prog.AddLinearConstraint(np.eye(3), [0] * 3, [1] * 3, x)),
    "bounds as numbers": with_program(lambda prog, x: prog.AddBoundingBoxConstraint(0, 1, x)),
    "an attribute of one's own": with_program(lambda prog, x: setattr(prog, "mine", 1)),
    "a weak reference": with_program(lambda prog, x: weakref.ref(prog) is not None),
    "an option of an int64": lambda: SolverOptions().SetOption(ClarabelSolver.id(), "max_iter", np.int64(3)),
    "a system in Python": evaluated,
}


def outcome(idiom: Callable[[], Any]) -> str:
    """`works`, or the kind of the error."""
    try:
        idiom()
    except Exception as error:
        return type(error).__name__
    return "works"


def main(file: Path) -> None:
    """Adds a column for the version that is installed."""
    rows: dict[str, dict[str, str]] = {name: {} for name in IDIOMS}
    if file.exists():
        with file.open(encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                rows.setdefault(row.pop("idiom"), {}).update(row)
    for name, idiom in IDIOMS.items():
        rows[name][version("drake")] = outcome(idiom)
    versions = sorted({name for row in rows.values() for name in row})
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ["idiom", *versions])
        writer.writeheader()
        writer.writerows({"idiom": name, **row} for name, row in rows.items())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
