"""Archives for PX4's ``mc_raptor``, loaded and flown by RLtools, the engine of the module: 100,000 inputs against torch.

``make firmware-tools`` installs its headers. ``-s`` prints the figures of ``docs/results/export.md``."""

import subprocess
from copy import deepcopy
from pathlib import Path
from shutil import which

import numpy as np
import pytest
import torch

from aerial_gym.config.storage import user_cache_folder
from aerial_gym.export.export import write_policy
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.targets import raptor
from aerial_gym.export.targets.requirements import action_numbers, engine_inputs
from aerial_gym.export.targets.tflm_engine import ENVIRONMENT
from tests.engines.policies import STEPS, compare
from tests.unit.export.test_raptor import raptor_policy

ROWS = 100_000
HEADERS = next(user_cache_folder(ENVIRONMENT).glob("lib/python*/site-packages/rltools/external/rl_tools/include"), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(HEADERS is None or which("g++") is None, reason="needs g++ and RLtools: make firmware-tools"),
]


@pytest.mark.parametrize("robot", ["x500", "crazyflie_21"])
@torch.no_grad()
def test_rltools_flies_the_archive(robot: str, tmp_path: Path) -> None:
    """Actions before their limits in flights of 10 steps, within the limit of ``aerial_gym.export.agreement``."""
    program = tmp_path / "engine"
    source = Path(__file__).parents[1] / "engines" / "raptor.cpp"
    subprocess.run(["g++", "-std=c++17", "-O2", f"-I{HEADERS}", str(source), "-o", str(program)], check=True)
    policy, made = raptor_policy(robot=robot)
    file = write_policy(policy, made, tmp_path, ["raptor"], check=False)[0].file
    seen = torch.randn(ROWS, made.num_observations, generator=torch.Generator().manual_seed(2))
    inputs = engine_inputs(seen, *raptor.module_places(made), raptor.NUM_INPUTS)
    inputs[:, 9:12] = 1.0  # the policy does not observe these
    done = subprocess.run([str(program), str(file)], input=inputs.numpy().tobytes(), capture_output=True, check=True)
    actions = torch.from_numpy(np.frombuffer(done.stdout, "<f4").reshape(-1, 4).copy())
    numbers = action_numbers(made, raptor.MOTORS)
    exact, rounded = ([] for _ in range(2))
    for results, kind in ((exact, torch.float64), (rounded, torch.float32)):
        flown = DeployablePolicy(deepcopy(policy), made).to(kind)
        memory = torch.zeros(ROWS // STEPS, 16, dtype=kind)
        for step in range(STEPS):
            now = {"observations": (seen[step::STEPS].to(kind) * flown.scale)}
            mean, memory = flown.policy.step(now, memory)
            results.append(mean[:, numbers])
    stacked = (torch.stack(each, dim=1).flatten(0, 1) for each in (exact, rounded))
    worst = compare(raptor.MOTORS, *stacked, actions).worst
    print(f"{robot}: error {worst.error:.1e} limit {worst.limit:.1e}, archive {file.stat().st_size / 1e3:.0f} kB")
    assert worst.holds, worst
