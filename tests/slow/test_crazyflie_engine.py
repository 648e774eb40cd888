"""The exported Crazyflie controller on an emulated STM32F405: 100,000 states against torch, memory, instructions.

``make firmware-tools`` installs the compiler and qemu. ``-s`` prints the figures of ``docs/results/export.md``."""

from pathlib import Path
from shutil import which

import pytest

from aerial_gym.export.export import write_policy
from aerial_gym.export.targets.requirements import X_PLACES
from tests.engines.crazyflie import build, fly, run, shares, write_states
from tests.engines.policies import commands, compare, engine_layout, random_states
from tests.unit.export.policies import random_policy

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        which("arm-none-eabi-gcc") is None or which("qemu-system-arm") is None,
        reason="needs arm-none-eabi-gcc and qemu-system-arm: make firmware-tools",
    ),
]
TERMS = ("position_error_world", "rotation_rows", "lin_vel_world", "ang_vel_body", "policy_action")
CASES = [((64, 64), "elu", 0), ((64, 64), "tanh", 0), ((64, 64), "relu", 0), ((32, 32), "elu", 32)]


@pytest.mark.parametrize(("hidden", "activation", "memory"), CASES)
def test_the_controller_flies_on_a_cortex_m4(hidden, activation, memory, tmp_path: Path) -> None:
    """Forces of 100,000 states in flights of 10 steps, within the limit of ``aerial_gym.export.agreement``; no allocation."""
    policy = random_policy(19, activation=activation, memory=memory, hidden_layers=hidden)
    policy.head.weight.data *= 0.05
    made, states = engine_layout(policy, TERMS, kind="speed"), random_states(100_000)
    folder = write_policy(policy, made, tmp_path, ["crazyflie"], check=False)[0].file.parent
    write_states(folder, states)
    forces, printed = fly(build(folder, made.name, arm=True), arm=True)
    exact, rounded = (shares(made, commands(policy, made, each)) for each in (states.double(), states))
    worst = compare(tuple(X_PLACES), exact, rounded, forces).worst
    assert worst.holds, worst
    objects = [f"{made.name}.o", f"{made.name}_controller.o"]
    undefined = run("arm-none-eabi-nm", "-u", *objects, cwd=folder)
    assert not {"malloc", "calloc", "realloc", "free"} & set(undefined.split())
    text, data, zeros = (sum(each) for each in zip(*_sizes(folder, objects), strict=True))
    stack = max(int(line.split("\t")[1]) for file in folder.glob("*.su") for line in file.read_text().splitlines())
    print(
        f"{activation} {hidden} memory {memory}: error {worst.error:.1e} limit {worst.limit:.1e}, flash {text + data} B, "
        f"RAM {data + zeros} B, largest frame {stack} B, {printed.strip()}"
    )
    assert stack <= 256, "layers must not be on the stack of the stabilizer task"


def _sizes(folder: Path, objects: list[str]) -> list[tuple[int, int, int]]:
    """Return bytes of code with constants, initialised data, and zeros of each object."""
    rows = run("arm-none-eabi-size", *objects, cwd=folder).splitlines()[1:]
    return [(int(text), int(data), int(zeros)) for text, data, zeros, *_ in map(str.split, rows)]
