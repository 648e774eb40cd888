"""The package ``examples/plug_ins`` has a part of each kind; the page of plug-ins flies and trains with them. Broken
packages disturb nobody."""

import logging
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from aerial_gym import EFFECTS, ROBOTS, SENSORS, task_registry
from aerial_gym.assets import FAMILIES
from aerial_gym.config.environment import FamilyCfg
from aerial_gym.physics.capabilities import choose_backend
from aerial_gym.registry import plugins
from aerial_gym.rl_training.run.run_folder import append_session
from aerial_gym.rl_training.trainers.catalog import trainers_with_feature
from aerial_gym.robots.robot_draws import quantity_names
from aerial_gym.sensors.rays import ray_table
from aerial_gym.sim2real.logs.readers.log_readers import find_reader
from tests.conftest import REGISTRIES

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "plug_ins"
ASKED = (
    "effect", "control_law", "reward", "observation", "command", "buffer", "sensor", "shape", "environment", "log_reader",
    "trainer", "backend", "robot", "task",
)  # fmt: skip
"""Kinds with an example."""


def test_every_example_loads_from_its_own_file(
    install_project: Callable[[Path], None], caplog: pytest.LogCaptureFixture
) -> None:
    install_project(PACKAGE)
    parts = [(registry, name) for registry in REGISTRIES for name in registry.packages()]
    assert len(parts) == len(ASKED) + 1  # the law is a controller as well
    assert all(registry.packages()[name] == "quad-lab" for registry, name in parts)
    for registry, name in parts:
        assert registry.summaries()[name], name
        registry.get(name)
    assert not caplog.messages
    points = re.findall(r'^"(\w+)\.\w+" = "quad_lab[.:](\w+)', (PACKAGE / "pyproject.toml").read_text(), re.MULTILINE)
    assert sorted(kind for kind, _ in points) == sorted(ASKED)
    assert len({file for _, file in points}) == len(ASKED)


def test_the_page_has_every_kind_and_every_example() -> None:
    page = (ROOT / "docs" / "guides" / "plug_ins.md").read_text(encoding="utf-8")
    assert [kind for kind in plugins.KINDS if f"`{kind}`" not in page] == []
    files = (path.name for path in (PACKAGE / "quad_lab").iterdir() if path.name[:2] != "__")
    assert [name for name in files if f"quad_lab/{name})" not in page] == []


def test_rays_and_shapes_of_a_plug_in_are_what_its_code_says(install_project: Callable[[Path], None]) -> None:
    install_project(PACKAGE)
    rays = ray_table(SENSORS.get("wave_scanner"), device=torch.device("cpu"))
    assert rays.shape == (1, 72, 3)
    azimuth = torch.arange(72) * (2.0 * torch.pi / 72)
    torch.testing.assert_close(rays[0, :, 2], torch.sin(0.35 * torch.sin(3.0 * azimuth)))
    torch.testing.assert_close(torch.atan2(rays[0, :, 1], rays[0, :, 0]) % (2.0 * torch.pi), azimuth)
    (arch,) = FAMILIES.get("arches").shapes(FamilyCfg(name="arches", variants=1, seed=3))
    left, right, beam = arch.parts
    assert left.position[1] == -right.position[1] > 0.45
    assert beam.position[2] == pytest.approx(0.5 * left.shape.size[2] + 0.05)


def test_a_run_notes_the_version_of_a_package_in_use(
    install_project: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(plugins.plugin_versions, "quad-lab", raising=False)
    install_project(PACKAGE)
    EFFECTS.get("cable_weight")
    append_session(tmp_path, seed=0, device="cpu")
    assert '"quad-lab": "0.1.0"' in (tmp_path / "versions.json").read_text(encoding="utf-8")


def test_broken_parts_of_every_kind_disturb_nobody(
    install: Callable[..., Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Each is reported once at most, where all entries of its kind are needed."""
    install(
        "bad-lab",
        {f"{kind}.bad": "bad_lab:Bad" for kind in plugins.KINDS if kind != "controller"},  # a control law is one too
        bad_lab="raise RuntimeError('no luck')\n",
    )
    log = tmp_path / "log.bin"
    log.write_bytes(b"unknown")
    with caplog.at_level(logging.WARNING):
        assert find_reader(log) is None
        assert "ppo" in trainers_with_feature("any_inputs")
        assert "body.mass" in quantity_names(ROBOTS.get("base_quadrotor"), gains=())
        assert type(choose_backend("auto")).__name__ == "WarpBackend"
        with task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", backend="torch") as task:
            task.reset()
    lines = [line for line in caplog.messages if "bad-lab" in line]
    assert len(lines) == len(set(lines))
    assert {"log_reader", "trainer", "effect"} <= {line.split()[4] for line in lines}
    assert all(line.endswith("RuntimeError: no luck. It is left out") for line in lines)
