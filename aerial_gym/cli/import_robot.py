"""``aerial-gym robot import``: a robot file from the file of another simulator."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class ImportRobotCmd:
    """Write a robot file (.yaml) from a URDF, MJCF or SDF file; one that cannot be flown is refused with the reason."""

    file: Annotated[Path, tyro.conf.Positional]  # URDF, MJCF or SDF file
    out: Path  # Robot file to write (.yaml)

    rotors_of: str | None = None
    """Robot, by name or file, whose rotor type these are; where the file has no rotors, its mounts are taken too."""

    spins: tuple[int, ...] = ()
    """1 or -1 for each rotor, in the order of the file and in place of what it says: 1 turns positively about the thrust."""

    lag_s: float | None = None
    """First-order lag of thrusts that follow at once in the file, and of rotors in `properties` of a URDF [s]."""

    rotor_links: str | None = None
    """Regular expression of links that are rotors, in a URDF without motors; names with motor, rotor or prop if not given."""

    joints: bool = False
    """Let revolute, continuous and prismatic joints move, but those of rotors; without it all are welded at zero."""

    accept_losses: bool = False  # Import a vehicle although its wings, or the joints that tilt its rotors, are left out
    summary: str | None = None  # One line for people who choose a robot

    def run(self) -> int:
        """Import, write and list unused elements; return the exit status."""
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.importers import RotorHints, import_robot

        rotor_robot = None if self.rotors_of is None else robot_by_name(self.rotors_of)
        hints = RotorHints(
            rotors_of=rotor_robot,
            spins=self.spins,
            lag=self.lag_s,
            joints=self.joints,
            accept_losses=self.accept_losses,
        )
        if self.rotor_links is not None:
            hints = replace(hints, rotor_links=self.rotor_links)
        imported = import_robot(self.file, hints)
        if self.summary is not None:
            imported = replace(imported, robot=replace(imported.robot, summary=self.summary))
        self.out.write_text(imported.as_file(self.file.name), encoding="utf-8", errors="surrogateescape")
        for line in imported.lines():
            print(line, file=sys.stderr)
        print(self.out)
        return 0
