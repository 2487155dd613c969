"""Certified grasps with their lifts and holds, weak ones among them, from which scores are fitted and tested.

    python studies/scores/make.py fit OUT --minutes 15
    python studies/scores/make.py test OUT --minutes 15 --meshes REFERENCE/objects/meshes

`fit` draws hands of the set g1 and shapes of the set s1, test families left out; `test` draws the development meshes,
and the library's hands and generated hands that validate (`studies/splits`). A unit is a scene, a hand whose search
asks no more than the certificate (`finish.GIVEN`), and two hands that its lifted grasps are carried to. Every grasp is
lifted, held and pushed. A unit that is there is not made again.
"""

import argparse
import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from xdex_drake.dataset.grasp_file import write_grasps
from xdex_drake.dataset.rows import rows_of, timeless
from xdex_drake.errors import XdexError
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import GIVEN
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch, lift_all, named
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.description import Hand
from xdex_drake.hand.library import load_hand
from xdex_drake.jobs.pairs import carry_over
from xdex_drake.jobs.workbench import use_one_thread
from xdex_drake.programs.force_closure import PolishSettings
from xdex_drake.scene.generator import family_name
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene, resting_scene
from xdex_drake.simulation.drake import shared_rig
from xdex_drake.simulation.protocol import HOLD

SPLITS = yaml.safe_load((Path(__file__).parents[1] / "splits" / "held_out.yaml").read_text(encoding="utf-8"))
LIBRARY = ("inspire", "ability", "schunk_svh", "shadow", "allegro")
GRASPS = 8
"""Certified grasps of a search, and most lifted ones that are carried over to each of two hands."""


def drawn(kind: str, number: int, meshes: Path) -> tuple[Scene, list[Hand]]:
    """Scene and three hands of a unit."""
    rng = np.random.default_rng([11, kind == "test", number])
    if kind == "test":
        mesh = meshes / f"{SPLITS['development_meshes'][number % 12]}.obj"
        names = [*rng.choice(LIBRARY, 2, replace=False), str(rng.choice(SPLITS["validation_hands"]))]
        model = load_object(mesh)
    else:
        shapes = (f"s1-{k:04d}" for k in rng.integers(0, 1000, 1000))
        shape = next(name for name in shapes if family_name(name) not in SPLITS["test_families"])
        # Every fifth generated hand is a person's: half of the hands here, so that both kinds are well known.
        names = [f"g1-{k:04d}" for k in (5 * rng.integers(200), *rng.integers(0, 1000, 2))]
        model = load_object(shape, scale=round(float(rng.uniform(0.65, 1.3)), 2))
    scene = resting_scene(model, index=int(rng.integers(3)), seed=0)
    return scene, [load_hand(name) for name in rng.permutation(names)]


def unit(kind: str, number: int, meshes: Path) -> list[dict]:
    """Rows of a unit."""
    scene, (source, *targets) = drawn(kind, number, meshes)
    friction = 0.5 if number % 2 else PolishSettings().friction_fraction
    settings = SynthesisSettings(polish=PolishSettings(friction_fraction=friction), batch=64, demands=GIVEN)
    found = candidates_of_batch(source, scene, seed=number, settings=settings, tally=Tally())
    rig = replace(shared_rig(source, scene), protocol=HOLD)
    named_grasps = (named(grasp, scene, number, 0) for grasp in itertools.islice(found, GRASPS))
    grasps = list(lift_all(rig, named_grasps, Tally()))
    rows = rows_of(map(timeless, grasps), source, scene)
    sources = [grasp for grasp in grasps if grasp.lift is not None and grasp.lift.success]
    for target in targets:
        carried = [g for g in carry_over(sources, source, target, scene, 1, 0) if isinstance(g, Grasp)]
        rows += rows_of(map(timeless, carried), target, scene)
    return rows


def main() -> None:
    """Makes units until time is up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("fit", "test"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--meshes", type=Path, default=Path("../shared/objects/meshes"))
    options = parser.parse_args()
    use_one_thread()
    begin, rows = time.monotonic(), 0
    for number in itertools.count():
        path = options.out / f"{options.kind}-{number:04d}.parquet"
        if path.exists():
            continue
        if time.monotonic() - begin > 60.0 * options.minutes:
            break
        try:
            made = unit(options.kind, number, options.meshes)
        except XdexError as error:
            print(f"{path.stem}: {error}", flush=True)
            continue
        write_grasps(path, made)
        rows += len(made)
        lifted, held = (sum(row[name] is True for row in made) for name in ("success", "holds"))
        seconds = time.monotonic() - begin
        print(f"{path.stem}: {len(made)} grasps, {lifted} lifted, {held} held; {rows} in {seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
