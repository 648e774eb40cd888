"""``python -m benchmarks.speed.start``: how long a task takes from the start of the process to its tenth step, part by part.

With ``--readme`` the example of README.md runs instead, to the first step of its environment and of its task. With ``--train``
a training with ``ppo`` runs instead, as ``aerial-gym train`` does it, and its policy is evaluated. Run any of them twice: the
first run of a machine compiles kernels. ``--cold`` makes any run a first one.
"""

import argparse
import ast
import json
import os
import re
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

_BEGIN = time.perf_counter() - time.process_time()  # the interpreter's own start counts as well, about

README = Path(__file__).parents[2] / "README.md"


def readme_example(text: str, *, device: str) -> list[ast.stmt]:
    """Return the statements of the first Python block of a page, on another device than ``auto``."""
    result = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    if result is None:
        raise ValueError("the page has no block of Python")
    return ast.parse(result[1].replace('device="auto"', f'device="{device}"')).body


def _run_readme(device: str, note: Callable[[str], None]) -> dict[str, object]:
    names: dict[str, object] = {}
    for statement in readme_example(README.read_text(encoding="utf-8"), device=device):
        with redirect_stdout(StringIO()):
            exec(compile(ast.Module([statement], []), str(README), "exec"), names)
        said = ast.unparse(statement)
        for start, label in (
            ("from aerial_gym", "imports"),
            ("env.step", "env_step_1"),
            ("env.render", "render"),
            ("obs, reward", "task_step_1"),
        ):
            if said.startswith(start):
                note(label)
    return {"example": README.name, "device": device}


def _run_task(asked: argparse.Namespace, note: Callable[[str], None]) -> dict[str, object]:
    import torch

    note("torch")
    import warp  # noqa: F401

    note("warp")
    from aerial_gym import task_registry

    capture = False if asked.no_capture else None
    task = task_registry.make_task(asked.task, num_envs=asked.num_envs, device=asked.device, capture=capture)
    note("make_task")
    task.reset()
    note("reset")
    actions = torch.zeros(task.num_envs, task.num_actions, device=task.device)
    for step in range(1, 11):
        task.step(actions)
        if step in (1, 10):
            float(task.episode_return[0])  # waits for the device
            note(f"step_{step}")
    return {"task": asked.task, "device": str(task.device), "captured": task.is_captured}


def _run_training(asked: argparse.Namespace, note: Callable[[str], None]) -> dict[str, object]:
    """Train for ``--train-s`` after the first iteration; the evaluation is not timed."""
    from aerial_gym.cli.process import cache_bytecode
    from aerial_gym.interop.preload import import_without_torch, preload
    from aerial_gym.lazy import pause_garbage_collection

    cache_bytecode()
    preload(asked.device)
    with pause_garbage_collection():
        import_without_torch()
        note("warp")
        import torch

        note("torch")
        from aerial_gym.interop.settings import resolve_device
        from aerial_gym.rl_training import TRAINERS, evaluate, load_settings, settings_for
        from aerial_gym.rl_training.trainers.learners import PpoTrainer
        from aerial_gym.task import task_registry
    note("imports")
    cfg = load_settings(settings_for("ppo", asked.task, device=asked.device))
    torch.set_num_threads(cfg.torch_threads or torch.get_num_threads())
    TRAINERS.get("ppo").prepare(resolve_device(asked.device))
    torch.manual_seed(asked.seed)
    task = task_registry.make_task(cfg.task, num_envs=cfg.num_envs, device=asked.device, seed=asked.seed, capture=False)
    note("build")
    training = PpoTrainer().make_training(cfg, task)
    for part in ("first_iteration", "recording"):
        training._repeat()
        float(training.learner.sums[0])  # waits for the device
        note(part)
    end = time.perf_counter() + asked.train_s
    while time.perf_counter() < end:
        training.learner.time_share.fill_(1.0 - (end - time.perf_counter()) / asked.train_s)
        training.advance()
    float(training.learner.sums[0])
    note("trained")
    result = evaluate(training.learner.network.actor, task_registry.make_task(
        cfg.task, num_envs=1000, device=asked.device, seed=asked.seed + 1
    ))  # fmt: skip
    return {"training": cfg.task, "device": asked.device, "final_error_mean_m": result.final_error_mean_m}


def main() -> None:
    """Print one JSON object; every number is the time since the process began [s], ``processor_s`` that of its threads."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readme", action="store_true")
    parser.add_argument("--train", action="store_true")
    parser.add_argument("--train-s", type=float, default=0.5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cold", action="store_true", help="with empty caches of kernels")
    parser.add_argument("--task", default="position_setpoint_task")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--no-capture", action="store_true")
    asked = parser.parse_args()
    since: dict[str, object] = {}

    def note(kind: str) -> None:
        since[f"{kind}_s"] = round(time.perf_counter() - _BEGIN, 2)

    if asked.cold:
        os.environ.update({name: tempfile.mkdtemp() for name in ("WARP_CACHE_PATH", "TRITON_CACHE_DIR")})
    label = (
        _run_readme(asked.device, note)
        if asked.readme
        else _run_training(asked, note)
        if asked.train
        else _run_task(asked, note)
    )
    print(json.dumps({**label, **since, "processor_s": round(time.process_time(), 2)}))


if __name__ == "__main__":
    main()
