"""The exported Crazyflie controller, compiled for this machine or for a Cortex-M4 in qemu, on rows of states."""

import subprocess
from math import degrees
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from aerial_gym.export.layout import Layout
from aerial_gym.physics.catalog import ROTOR_MAPS
from tests.engines.policies import States

HERE = Path(__file__).parent
M4 = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion")
MOTORS = (0, 1, 2, 3)  # Rotors of crazyflie_21 in the order of its motors


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run([str(each) for each in command], cwd=cwd, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, f"{command[0]}: {done.stdout}{done.stderr}"
    return done.stdout


def build(folder: Path, name: str, *, arm: bool) -> Path:
    """Return the program that flies rows, and its objects beside it."""
    compiler, target = ("arm-none-eabi-gcc", M4) if arm else ("gcc", ())
    objects = []
    for source in (f"{name}.c", f"{name}_controller.c"):
        run(compiler, *target, *STRICT, "-fstack-usage", f"-I{HERE}", "-c", source, cwd=folder)
        objects.append(source.replace(".c", ".o"))
    start = (HERE / "cortex_m4.c", "-T", HERE / "cortex_m4.ld", "-nostartfiles", "--specs=rdimon.specs") if arm else ()
    run(
        compiler, *target, "-O2", f"-I{HERE}", HERE / "fly_rows.c", *objects, *start, "-lm", "-o", "fly.elf", cwd=folder
    )
    return folder / "fly.elf"


def write_states(folder: Path, states: States, mode: float = 1.0) -> None:
    gyro, modes = degrees(1.0) * states.ang_vel, torch.full((len(states.position), 1), mode)
    parts = (states.position, states.velocity, states.quaternion, gyro, states.target, states.target_velocity, modes)
    np.asarray(torch.cat(parts, dim=-1), dtype="<f4").tofile(folder / "states.bin")


def fly(program: Path, *, arm: bool) -> tuple[Tensor, str]:
    """Return the forces (B, 4) of the rows beside a program, as shares, and what it printed."""
    machine = ("qemu-system-arm", "-M", "netduinoplus2", "-nographic", "-icount", "shift=0", "-semihosting-config",
               "enable=on,target=native", "-kernel")  # fmt: skip
    text = run(*(machine if arm else ()), program, cwd=program.parent)
    return torch.from_numpy(np.fromfile(program.parent / "forces.bin", dtype="<f4").reshape(-1, 4)), text


def shares(made: Layout, command: Tensor) -> Tensor:
    """Return commands (B, 4) as shares of the largest thrust of motors 1 to 4, by the rotor maps of the simulator."""
    rotor = made.rotors[0]
    if made.command[0].startswith("speed"):
        command = ROTOR_MAPS.get(rotor.rotor_map).evaluate(command.new_tensor(rotor.thrust_map), command)
    return command[:, MOTORS] / rotor.thrust_range[1]
