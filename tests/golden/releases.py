"""Golden results of files that release 0.1.0 wrote: runs, checkpoints, exported policies, robot files. They must still
load. The files lie in ``reference/0.1.0``. ``python -m tests.golden.releases FOLDER`` wrote them with that release.
Checkpoints hold tensors, numbers and text; they name no Python module or class. But keys of the state, such as
``body.layers.0.weight``, are attributes of networks: whoever renames an attribute must read the old key as well."""

import io
import json
import shutil
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml, to_mapping
from aerial_gym.env_manager import robot_by_name
from aerial_gym.export import load_exported
from aerial_gym.rl_training import load_policy, load_settings, settings_for
from aerial_gym.task import task_registry

HAS_PROSE = False

TOLERANCE_ELSEWHERE = 1e-3
"""Largest relative difference of actions on another kind of machine."""

FILES = Path(__file__).parent / "reference" / "0.1.0"

TRAINERS = ("ppo", "apg", "rl_games", "sample_factory")

EXPORTS = ("onnx", "torchscript", "c99")

SUFFIX = {"onnx": ".onnx", "torchscript": ".pt", "c99": ".c"}


def items() -> dict[str, bool]:
    """Return the names of all results, and whether each is a quick one."""
    return {f"run/{name}": True for name in TRAINERS} | {"export": True, "robot": True, "resume": True}


def measure(item: str) -> dict[str, Any]:
    """Return the results of one group of files, named ``kind`` or ``kind/name``."""
    kind, _, name = item.partition("/")
    return {"run": _run, "export": _export, "robot": _robot, "resume": _resume}[kind](name)


def _observations(width: int) -> dict[str, torch.Tensor]:
    return {"observations": torch.randn(4, width, generator=torch.Generator().manual_seed(0))}


def _run(trainer: str) -> dict[str, Any]:
    """Return settings, actions and the contents of the checkpoint of a run."""
    folder = FILES / trainer
    policy, cfg = load_policy(folder)
    payload = torch.load(next(folder.glob("checkpoints/*.pth")), weights_only=True)  # refuses any class
    actions = policy(_observations(policy.shapes["observations"][0]))
    return {"actions": actions.tolist(), "settings": to_mapping(cfg), "checkpoint": sorted(payload)}


def _export(_: str) -> dict[str, Any]:
    """Return the actions of each exported file."""
    results = {}
    for kind in EXPORTS:
        pilot = load_exported(FILES / "export" / f"hover{SUFFIX[kind]}")
        results[kind] = pilot(_observations(pilot.shapes["observations"][0])).tolist()
    return results


def _robot(_: str) -> dict[str, Any]:
    """Return the robot that the closed loop corrected, as the present release reads it, and rewards of its flight."""
    file = FILES / "robot.yaml"
    with task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", robot=str(file)) as task:
        task.reset(seed=0)
        reward = task.step(torch.zeros(2, task.num_actions))[1]
    return {"reward": reward.tolist(), "robot": to_mapping(robot_by_name(file))}


def _resume(_: str) -> dict[str, Any]:
    """Return the figures of a training that goes on from the checkpoint of the release."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "ppo"
        shutil.copytree(FILES / "ppo", run)
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            status = main(["train", "--out", str(run), "--resume", "--max-env-steps", "1024"])
        result = json.loads((run / "result.json").read_text(encoding="utf-8"))
        return {"status": status, "late": {key: result[key] for key in ("env_steps", "episode_return")}}


def write_files(folder: Path) -> None:
    """Train a small policy with each trainer, export one, correct a robot, and keep the files that must load later."""
    from tests.golden.cases import robot_yaml_with_origins

    for trainer in TRAINERS:
        cfg = load_settings(settings_for(trainer, "position_setpoint_task", device="cpu"))
        section = "apg" if trainer == "apg" else "ppo"
        small = replace(getattr(cfg, section), hidden_layers=(8, 8), horizon=16)
        limits = {"num_envs": 16, "max_env_steps": 512, "max_time_s": None, "device": "cpu", "seed": 1}
        with tempfile.TemporaryDirectory() as temporary:
            settings, run = Path(temporary) / "settings.yaml", Path(temporary) / trainer
            settings.write_text(dump_yaml(replace(cfg, **limits, **{section: small})), encoding="utf-8")
            main(["train", "--config", str(settings), "--out", str(run)])
            kept = folder / trainer / "checkpoints"
            kept.mkdir(parents=True)
            shutil.copy(max(run.glob("checkpoints/*.pth")), kept)
            shutil.copy(run / "config.yaml", folder / trainer)
            sessions = json.loads((run / "versions.json").read_text(encoding="utf-8"))
            text = json.dumps([session | {"machine": "x86_64"} for session in sessions], indent=1)
            (folder / trainer / "versions.json").write_text(f"{text}\n", encoding="utf-8")
    out = ["--name", "hover", "--out", str(folder / "export")]
    main(["export", "--policy", str(folder / "ppo"), "--to", *EXPORTS, *out])
    _forget_places(folder / "export" / "hover.onnx")
    (folder / "robot.yaml").write_text(robot_yaml_with_origins("com_offset"), encoding="utf-8")


def _forget_places(file: Path) -> None:
    """Remove the stack traces, which hold the paths of one machine, from an ONNX file."""
    import onnx

    model = onnx.load(file)
    for node in model.graph.node:
        del node.metadata_props[:]
    onnx.save(model, file)


if __name__ == "__main__":
    write_files(Path(sys.argv[1]))
