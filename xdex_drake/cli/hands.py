"""`xdex hand ...`: the hands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from xdex_drake.cli.output import check_output_file, facts, table

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat, SceneGraph
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.systems.framework import DiagramBuilder

    from xdex_drake.hand.description import Hand

HandName = Annotated[str, tyro.conf.arg(metavar="HAND")]


@dataclass(frozen=True)
class HandList:
    """The hands of the library.

    Their names work wherever a command takes a HAND: `xdex hand list`, then `xdex hand show allegro`.
    """

    def run(self) -> int:
        """Prints one line a hand."""
        from xdex_drake.hand.library import list_hands, load_hand

        rows = []
        for name in list_hands():
            hand = load_hand(name)
            fingers = ", ".join(finger.name for finger in hand.fingers)
            rows.append((name, hand.display_name, hand.side, len(hand.joint_names), len(hand.joints), fingers))
        print(table(rows, ("hand", "name", "side", "actuated", "joints", "fingers")))
        return 0


@dataclass(frozen=True)
class HandShow:
    """One hand: its joints, fingers, and where each fact comes from.

    Try `xdex hand show shadow`, or give the path of a hand file to check it.

    Attributes:
        hand: Name of a hand of the library, or the path of a .yaml file.
    """

    hand: tyro.conf.Positional[HandName]

    def run(self) -> int:
        """Prints tables."""
        from xdex_drake.hand.library import load_hand
        from xdex_drake.hand.yaml_file import hand_digest

        hand = load_hand(self.hand)
        mass = sum(link.mass for link in hand.links)
        print(
            facts(
                [
                    ("hand", f"{hand.name} ({hand.display_name}), {hand.side}"),
                    ("links", len(hand.links)),
                    ("actuated joints", f"{len(hand.joint_names)} of {len(hand.joints)}"),
                    ("mass [kg]", mass),
                    ("collision spheres", len(hand.spheres)),
                    ("digest", hand_digest(hand)),
                ]
            )
        )
        rest = dict(zip(hand.joint_names, hand.q_rest, strict=True))
        rows = []
        for joint in hand.joints:
            law = joint.coupling
            note = f"{law.multiplier:.3g} x {law.master} {law.offset:+.3g}" if law else f"rest {rest[joint.name]:.3g}"
            rows.append((joint.name, joint.kind, joint.child, joint.lower, joint.upper, joint.effort, note))
        print("\n" + table(rows, ("joint", "kind", "moves", "lower", "upper", "effort", "rest or coupling")))
        print("\n" + table([(f.name, f.tip_link, len(f.links)) for f in hand.fingers], ("finger", "tip link", "links")))
        print("\n" + table(sorted(hand.sources.items()), ("fact", "source")))
        return 0


@dataclass(frozen=True)
class HandView:
    """One hand in Meshcat, at its rest posture.

    Try `xdex hand view allegro`, or `xdex hand view allegro --html allegro.html` for a page that works offline.

    Attributes:
        hand: Name of a hand of the library, or the path of a .yaml file.
        html: Write one self-contained page instead of showing the hand live.
    """

    hand: tyro.conf.Positional[HandName]
    html: Path | None = None

    def run(self) -> int:
        """Shows the hand until Enter is pressed, or writes the page."""
        if self.html is not None:
            check_output_file(self.html, ".html")
        from xdex_drake.cli.show import wait_for_enter, write_text
        from xdex_drake.hand.library import load_hand
        from xdex_drake.visualization.replay import start_meshcat

        hand = load_hand(self.hand)
        meshcat = start_meshcat()
        _draw_hand(meshcat, hand)
        if self.html is None:
            return wait_for_enter(meshcat.web_url())
        write_text(self.html, meshcat.StaticHtml())
        print(f"{hand.name}: {self.html}")
        return 0


def _draw_hand(meshcat: Meshcat, hand: Hand) -> None:
    """Draws a hand at rest, its wrist at the origin."""
    from pydrake.geometry import MeshcatVisualizer
    from pydrake.math import RigidTransform

    from xdex_drake.scene.plant import build_plant

    def extend(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)

    bench = build_plant(hand, extend=extend)
    context = bench.diagram.CreateDefaultContext()
    plant_context = bench.plant.GetMyMutableContextFromRoot(context)
    bench.set_joints(plant_context, hand.q_rest)
    bench.set_wrist(plant_context, RigidTransform())
    bench.diagram.ForcedPublish(context)
