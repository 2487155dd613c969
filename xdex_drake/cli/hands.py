"""`xdex hand ...`: the hands."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from xdex_drake.cli.output import check_output_file, facts, table
from xdex_drake.errors import ConfigError

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from xdex_drake.arrays import Array
    from xdex_drake.hand.description import Hand

HandName = Annotated[str, tyro.conf.arg(metavar="HAND")]


@dataclass(frozen=True)
class HandList:
    """The hands of the library, and how else a HAND can be named.

    Their names work wherever a command takes a HAND: `xdex hand list`, then `xdex hand show allegro`. So do names of
    generated hands, as g0-0137, and the path of a hand's file: .yaml, .urdf, .xml (MJCF) or .sdf.
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
        print(
            "\nA HAND is also g0-0137 (number 137 of the generated hands of seed 0; any seed and number work), or the"
        )
        print(
            "path of a .yaml, .urdf, .xml (MJCF) or .sdf file, which is imported as it is (`xdex hand import --help`)."
        )
        return 0


@dataclass(frozen=True)
class HandShow:
    """One hand: its joints, fingers, and where each fact comes from.

    Try `xdex hand show shadow`, or give the path of a hand file to check it.

    Attributes:
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
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
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
        html: Write one self-contained page instead of showing the hand live.
    """

    hand: tyro.conf.Positional[HandName]
    html: Path | None = None

    def run(self) -> int:
        """Shows the hand until Enter is pressed, or writes the page."""
        if self.html is not None:
            check_output_file(self.html, ".html")
        from xdex_drake.cli.show import wait_for_enter
        from xdex_drake.hand.library import load_hand
        from xdex_drake.visualization.hand_browser import browser_page
        from xdex_drake.visualization.stage import start_meshcat
        from xdex_drake.whole_file import write_text

        hand = load_hand(self.hand)
        if self.html is not None:
            write_text(self.html, browser_page([hand], title=hand.display_name))
            print(f"{hand.name}: {self.html}")
            return 0
        meshcat = start_meshcat()
        _draw_hand(meshcat, hand)
        return wait_for_enter(meshcat.web_url())


@dataclass(frozen=True)
class HandImport:
    """Imports a hand from a URDF, MJCF or SDFormat file, with no annotation.

    Palm, wrist frame, fingers, fingertips, couplings, shapes, spheres and inertias are found by themselves; what was
    missing or invalid is mended. Each choice is printed: "decided" where several would do, "mended" where the file is
    wrong or silent, "warning" where you should look. The .yaml file that it writes can be corrected with an editor and
    used wherever a HAND is asked for. To grasp at once, this command is not needed: `xdex grasp --hand hand.urdf ...`.

    Meshes are read from the hand's own folder only: that of the file, or the ROS package (marked by package.xml) that
    the file lies in, and packages beside it or on ROS_PACKAGE_PATH that it names. --root and --package allow more. A
    xacro file is to be expanded first: `xacro hand.xacro > hand.urdf`.

    Try `xdex hand import hand.urdf --out hand.yaml --html hand.html`.

    Attributes:
        file: The file: .urdf, .xml (MJCF or URDF) or .sdf.
        name: Name of the hand, as it stands in grasp files; made from the file's name where not given.
        out: Where to write the description, a .yaml file; NAME.yaml in this folder where not given.
        side: Which hand it is, where the file cannot tell; of a robot with two hands, the one to take.
        palm: Name of the link that the fingers grow from, where the one that was found is wrong.
        root: A folder in which meshes and included files may lie besides the hand's own, as --root ..
        package: Where ROS packages that the file names are, as --package my_hand=../my_hand.
        html: Write a page with the hand, a slider for every joint, and each decision.
        force: Write over a description that is there already, even if it was edited.
    """

    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    name: str | None = None
    out: Path | None = None
    side: Literal["right", "left"] | None = None
    palm: str | None = None
    root: Path | None = None
    package: tuple[str, ...] = ()
    html: Path | None = None
    force: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Prints the decisions and writes the files."""
        if self.out is not None:
            check_output_file(self.out, ".yaml", overwrite=self.force)
        if self.html is not None:
            check_output_file(self.html, ".html")
        from xdex_drake.hand.importing.files import import_hand
        from xdex_drake.hand.yaml_file import write_hand

        imported = import_hand(
            self.file, name=self.name, side=self.side, palm=self.palm, root=self.root, packages=_packages(self.package)
        )
        hand = imported.hand
        out = self.out or Path(f"{hand.name}.yaml")
        if self.out is None:
            check_output_file(out, ".yaml", overwrite=self.force)
        coupled = sum(joint.coupling is not None for joint in hand.joints)
        print(
            facts(
                [
                    ("hand", f"{hand.name} ({hand.display_name}), {hand.side}"),
                    ("palm", hand.links[0].name),
                    ("links", len(hand.links)),
                    ("actuated joints", f"{len(hand.joint_names)} of {len(hand.joints)}, {coupled} coupled"),
                    ("mass [kg]", sum(link.mass for link in hand.links)),
                    ("collision spheres", len(hand.spheres)),
                ]
            )
        )
        rows = [(f.name, f.tip_link, len(f.links), _millimetres(f.p_LTip)) for f in hand.fingers]
        print("\n" + table(rows, ("finger", "tip link", "links", "tip point [mm]")))
        if imported.decisions:
            order = ("warning", "mended", "decided")
            told = sorted(imported.decisions, key=lambda d: order.index(d.severity) if d.severity in order else 3)
            print()
            for decision in told:
                text = f"{decision.subject}: {decision.text}"
                print(textwrap.fill(text, 110, initial_indent=f"{decision.severity:<9}", subsequent_indent=9 * " "))
        out.parent.mkdir(parents=True, exist_ok=True)
        write_hand(hand, out)
        print(f"\n{hand.name}: {out}; try `xdex hand view {out}` or `xdex grasp --hand {out}`")
        if self.html is not None:
            from xdex_drake.cli.show import write_text
            from xdex_drake.visualization.import_page import import_page

            write_text(self.html, import_page(imported))
            print(f"{hand.name}: {self.html}")
        return 0


def _packages(words: tuple[str, ...]) -> dict[str, Path]:
    packages = {}
    for word in words:
        name, equals, folder = word.partition("=")
        if not (name and equals and folder):
            raise ConfigError(f"--package {word}: give a name and a folder, as --package my_hand=../my_hand")
        packages[name] = Path(folder)
    return packages


def _millimetres(p: Array) -> str:
    return ", ".join(f"{1000.0 * value:.1f}" for value in p)


@dataclass(frozen=True)
class HandExport:
    """Writes a hand as a URDF, SDFormat or MJCF file with OBJ meshes, for other tools.

    URDF is what Pinocchio, yourdfpy, Drake and others open, SDFormat is for Gazebo and Drake; MJCF is for MuJoCo, with
    position actuators of the lifts' gains, contacts and armature set, ready for `python -m mujoco.viewer --mjcf=FILE`.
    Joint names, limits, efforts, couplings and inertias are the hand's own. The empty link (in SDFormat: frame, in
    MJCF: site) `wrist` marks the wrist frame, to which grasps refer; `thumb_tip`, `index_tip` and so on mark the
    fingertips.
    `dex_retargeting` writes a URDF whose root is the wrist frame, and a configuration for each objective of
    dex-retargeting 0.5; call its `RetargetingConfig.set_default_urdf_dir(FOLDER)` before loading one.
    Try `xdex hand export allegro --format mjcf --out allegro_mjcf`.

    Attributes:
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
        format: The format.
        out: Folder for the file and meshes/; NAME_FORMAT in this folder where not given.
    """

    hand: tyro.conf.Positional[HandName]
    format: Literal["urdf", "sdf", "mjcf", "dex_retargeting"] = "urdf"
    out: Path | None = None

    def run(self) -> int:
        """Writes the files."""
        from xdex_drake.hand.library import load_hand
        from xdex_drake.interchange.mjcf import export_mjcf
        from xdex_drake.interchange.sdf import export_sdf
        from xdex_drake.interchange.urdf import export_urdf
        from xdex_drake.retargeting.dex_retargeting import export_dex_retargeting

        hand = load_hand(self.hand)
        out = self.out or Path(f"{hand.name}_{self.format}")
        if self.format == "dex_retargeting":
            files = export_dex_retargeting(hand, out)
            print(f"{hand.name}: {', '.join(str(file) for file in files)}")
            return 0
        export = {"urdf": export_urdf, "sdf": export_sdf, "mjcf": export_mjcf}[self.format]
        print(f"{hand.name}: {export(hand, out)}")
        return 0


@dataclass(frozen=True)
class HandMirror:
    """Writes the left hand of a right one, or the other way round.

    Joints keep their names, limits and values: the same values give the mirrored pose. The result is a hand file like
    any other. Try `xdex hand mirror allegro --out allegro_left.yaml`, then `xdex hand view allegro_left.yaml`.

    Attributes:
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
        out: Where to write the description, a .yaml file.
        force: Write over a description that is there already, even if it was edited.
    """

    hand: tyro.conf.Positional[HandName]
    out: Path
    force: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Writes the file."""
        check_output_file(self.out, ".yaml", overwrite=self.force)
        from xdex_drake.hand.library import load_hand
        from xdex_drake.hand.mirror import mirror
        from xdex_drake.hand.yaml_file import write_hand

        other = mirror(load_hand(self.hand))
        self.out.parent.mkdir(parents=True, exist_ok=True)
        write_hand(other, self.out)
        print(f"{other.name}: {self.out}")
        return 0


def _draw_hand(meshcat: Meshcat, hand: Hand) -> None:
    """Draws a hand at rest, its wrist at the origin."""
    from pydrake.math import RigidTransform, RotationMatrix

    from xdex_drake.hand.kinematics import forward_kinematics
    from xdex_drake.visualization.stage import draw_hand

    names = [link.name for link in hand.links]
    draw_hand(meshcat, "/drake/hand", hand, names)
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), hand.q_rest[None])
    for name, R, p in zip(names, R_HLs[0], p_HLs[0], strict=True):
        meshcat.SetTransform(f"/drake/hand/{name}", RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p))
