"""Models for PX4's ``mc_nn_control`` in TensorFlow Lite Micro: 100,000 observations against torch, numbers that are not finite,
and the memory of the module.

``make firmware-tools`` installs the engine. ``-s`` prints the figures of ``docs/results/export.md``."""

import subprocess
from pathlib import Path

import pytest

from aerial_gym.config.storage import user_cache_folder
from aerial_gym.export.export import CHECKED, write_policy
from aerial_gym.export.targets import tflm
from aerial_gym.export.targets.tflm_engine import ENVIRONMENT
from tests.engines.policies import engine_layout
from tests.unit.export.policies import random_policy

PYTHON = user_cache_folder(ENVIRONMENT) / "bin" / "python"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON.is_file(), reason="needs TensorFlow Lite Micro: make firmware-tools"),
]
TERMS = ("position_error_world", "rotation_rows", "lin_vel_world", "ang_vel_body")
FIT = """import sys
from tflite_micro import runtime
for size in range(1024, int(sys.argv[2]) + 1, 256):
    try:
        runtime.Interpreter.from_file(sys.argv[1], arena_size=size).invoke()
    except RuntimeError:
        continue
    print(size)
    break
"""
"""Smallest memory [B] in which the engine flies a model, in steps of 256 B."""

CASES = [((24, 17), True), ((64, 64), True), ((64, 64), False), ((256, 256, 128), True)]


@pytest.mark.parametrize(("hidden", "normalize"), CASES)
def test_the_engine_gives_the_commands_of_the_policy(hidden: tuple[int, ...], normalize: bool, tmp_path: Path) -> None:
    """Commands, actions and NaN as ``export`` checks them, and tensors that fit into the module's memory. Pointers of this
    machine have 8 bytes, those of a flight controller 4, so that it needs less."""
    policy = random_policy(15, activation="relu", normalize=normalize, hidden_layers=hidden)
    policy.head.weight.data *= 0.05
    made = engine_layout(policy, TERMS, robot="x500", scale=0.5)
    (result,) = write_policy(policy, made, tmp_path, ["tflm"])
    assert result.agrees, result
    assert result.agreement is not None
    fit = [str(PYTHON), "-c", FIT, str(result.file), str(tflm.ARENA)]
    size = subprocess.run(fit, capture_output=True, text=True, check=True).stdout.strip()
    assert size, "does not fit into the memory of the module"
    print(
        f"{hidden}, normaliser {normalize}: {CHECKED} observations, error {result.agreement.error:.1e} "
        f"limit {result.agreement.limit:.1e} in {result.agreement.output}, {result.file.stat().st_size / 1e3:.0f} kB, "
        f"memory {size} of {tflm.ARENA} B"
    )
