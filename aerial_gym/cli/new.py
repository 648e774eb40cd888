"""``aerial-gym new``: a complete, commented file of a user's own that runs at once, with its test."""

from dataclasses import dataclass
from keyword import iskeyword
from pathlib import Path
from re import fullmatch
from typing import Annotated, Literal

import tyro

from aerial_gym.cli.list_names import KINDS
from aerial_gym.cli.terminal import print_table
from aerial_gym.errors import ConfigError

TEMPLATES = Path(__file__).parent / "templates" / "new"

NEXT_STEPS = {
    "robot": "aerial-gym robot check {file}",
    "task": "aerial-gym train --task {file} --max-time-s 60 --out runs/{name}",
    "environment": "aerial-gym view --env {file}",
    "sensor": "sensors: [{file}] in a robot file",
    "effect": "python {file}",
    "controller": "python {file}",
}  # First use of a file of each kind


@dataclass(frozen=True, kw_only=True)
class NewFileCmd:
    """Write a complete, commented task, environment, sensor, effect or controller, and its test."""

    kind: Annotated[Literal["task", "environment", "sensor", "effect", "controller"], tyro.conf.Positional]
    """Task, environment and sensor are files (.yaml), effect and controller Python modules. Robots: `aerial-gym new robot`."""

    name: Annotated[str, tyro.conf.Positional]  # Name in snake_case; also that of the file
    out: Path = Path()  # Folder of both files

    def run(self) -> int:
        """Write the files and print what to do next; return the exit status."""
        write_templates(self.kind, self.name, self.out)
        return 0


def write_templates(kind: str, name: str, folder: Path, text: str = "") -> None:
    """Write the templates of a kind under a name, after a ``text``; raise ``ConfigError`` if name or file is taken."""
    is_taken = any(name in home.load() for home in KINDS[f"{kind}s"])
    faults = [f"{kind} {name!r} is registered already: choose another name"] if is_taken else []
    if fullmatch("[a-z][a-z0-9_]*", name) is None or iskeyword(name):
        faults.append(f"name {name!r}: must be snake_case, such as my_{kind}")
    files = {path: folder / path.name.replace(f"my_{kind}", name) for path in sorted(TEMPLATES.glob(f"*my_{kind}.*"))}
    faults += [f"{file} exists: choose another name or --out, or remove it" for file in files.values() if file.exists()]
    if faults:
        raise ConfigError(*faults)
    folder.mkdir(parents=True, exist_ok=True)
    for template, file in files.items():
        content = template.read_text(encoding="utf-8").replace(f"my_{kind}", name)
        content = content.replace(f"My{kind.title()}", name.title().replace("_", ""))
        file.write_text(content if file.name.startswith("test_") else text + content, encoding="utf-8")
    file, test = files.values()
    print(f"written: {file}, {test}\ntest: python -m pytest {test}")
    print(f"next: {NEXT_STEPS[kind].format(file=file, name=name)}")


@dataclass(frozen=True, kw_only=True)
class NewRobotCmd:
    """Write a robot file (.yaml) from mass, propeller, motor and battery, and its test; rules of thumb fill the rest."""

    name: Annotated[str, tyro.conf.Positional]  # Name in snake_case; also that of the file
    out: Path = Path()  # Folder of both files
    mass_kg: Annotated[float, tyro.conf.arg(aliases=("--mass",))]  # Mass with battery [kg]
    arm_m: float | None = None  # Distance of the rotors from the centre [m]; by the propeller if not given
    propeller: str | None = None  # Diameter, pitch [inch] and blades, such as 5x4.3x3, or less of it
    motor_kv: float | None = None  # Speed constant of the motors [rpm/V]
    battery: str | None = None  # Cells and capacity [mA h], such as 6S1300, or cells alone, such as 6S
    max_thrust_n: float | None = None  # Thrust of one rotor at full command [N], in place of motor and battery
    frame: str = "quad_x"  # Places and spins of the rotors: quad_x, hexa_x, octo_x, quad_x_betaflight, ...

    def run(self) -> int:
        """Write the files and print each number with its origin; return the exit status."""
        from aerial_gym.robots.drafts.draft import LABELS, robot_yaml_with_origins
        from aerial_gym.robots.drafts.rules import draft_robot

        draft = draft_robot(
            mass=self.mass_kg, arm=self.arm_m, propeller=self.propeller, motor_kv=self.motor_kv, battery=self.battery,
            max_thrust=self.max_thrust_n, frame=self.frame,
        )  # fmt: skip
        text = robot_yaml_with_origins(draft, name=self.name, command="aerial-gym new robot")
        write_templates("robot", self.name, self.out, text)
        rows = [(LABELS[key], f"{each.value:.4g}", each.origin) for key, each in draft.values.items()]
        print_table(rows, ("number", "value", "origin"))
        return 0
