"""Pretrained policies of the package: ``python -m benchmarks.learning.policies`` evaluates all and prints a table.

``--pack RUN --command "aerial-gym train ..."`` copies settings and weights of a run folder into the package, without pickle.
"""

from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path

import numpy as np

from aerial_gym import evaluate, task_registry
from aerial_gym.config import CONFIG_DIR, dump_yaml
from aerial_gym.config.storage import read_archive, write_atomic
from aerial_gym.rl_training.evaluation import Evaluation
from aerial_gym.rl_training.policies.catalog import PREFIX, PRETRAINED
from aerial_gym.rl_training.policies.load import find_checkpoint
from aerial_gym.rl_training.run.run_folder import ARRAYS

STARTS = 1_000  # Random starts of each evaluation


def pack_run(run: Path, command: str) -> Path:
    """Write settings and weights of the last checkpoint of a run into the package; return the folder."""
    _, cfg = find_checkpoint(run)
    folder = CONFIG_DIR / PREFIX / cfg.task
    folder.mkdir(parents=True, exist_ok=True)
    write_weights(run, folder)
    summary = f"policy that can {task_registry.get(cfg.task).summary.partition(';')[0]}"
    write_atomic(folder / "config.yaml", dump_yaml(replace(cfg, summary=summary, source=f"made by: {command}")))
    return folder


def write_weights(run: Path, folder: Path) -> None:
    """Write the weights of the last checkpoint of a run into a folder, without the state of its simulation."""
    checkpoint, _ = find_checkpoint(run)
    payload = read_archive(checkpoint, "checkpoint")
    network = payload["network"]
    arrays = {f"model/{name}": tensor.numpy() for name, tensor in payload["model"].items()}
    arrays |= {f"network/shapes/{key}": np.array(shape) for key, shape in network["shapes"].items()}
    arrays["network/num_actions"] = np.array(network["num_actions"])
    np.savez_compressed(folder / ARRAYS, allow_pickle=False, **arrays)


def table_row(name: str, result: Evaluation) -> str:
    """Return the figures of a policy as a row of the table in docs/results/pretrained.md."""
    error, settling = result.final_error_mean_m, result.settling_time_mean_s
    rates = " | ".join(f"{100.0 * rate:.0f} %" for rate in (result.success_rate, result.crash_rate))
    return f"| `{name}` | {rates} | {error or 0.0:.3f} m | {settling or 0.0:.1f} s |"


def main() -> None:
    """Evaluate all policies, or pack one."""
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pack", type=Path, help="run folder")
    parser.add_argument("--command", help="the command that trained it")
    args = parser.parse_args()
    if args.pack is not None:
        print(pack_run(args.pack, args.command))
        return
    for name in PRETRAINED.names():
        print(table_row(name, evaluate(PREFIX / name, num_envs=STARTS)))


if __name__ == "__main__":
    main()
