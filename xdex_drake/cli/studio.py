"""`xdex studio`: a live page to play with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from xdex_drake.cli.output import one_thread


@dataclass(frozen=True)
class StudioCommand:
    """A live page to play with: choose hand and object, press grasp, next, lift, save, or carry the grasp to a hand.

    Sliders change the object's size, its friction, and the hand's size and the length of its fingers; the grasp
    follows. What takes longer runs in a process of its own. Try `xdex studio`, then open the address that it prints;
    `xdex studio --hand my_hand.urdf` plays with your own hand. Ctrl-C ends it.

    Attributes:
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        out: Folder of the grasps that are saved.
        port: Port of the page; a free one where 0.
    """

    hand: str = "allegro"
    object: str = "can"
    out: Path = Path("studio")
    port: int = 0

    def run(self) -> int:
        """Runs the studio until Ctrl-C."""
        one_thread()
        from xdex_drake.hand.library import load_hand
        from xdex_drake.visualization.studio import Choice, Studio, serve

        # What is wrong with the hand is told before anything starts.
        load_hand(self.hand)
        studio = Studio(Choice(hand=self.hand, object=self.object), self.out)
        server = serve(studio, self.port)
        print(f"the studio is open at http://localhost:{server.server_address[1]}/; Ctrl-C ends it", flush=True)
        try:
            studio.run()
        except KeyboardInterrupt:
            print()
        finally:
            server.shutdown()
        return 0
