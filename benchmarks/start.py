"""``python -m benchmarks.start``: how long a task takes from the start of the process to its tenth step, part by part.

Run it twice: the first run of a machine compiles kernels (``WARP_CACHE_PATH=$(mktemp -d)`` makes any run a first one).
"""

import argparse
import json
import time

_BEGIN = time.perf_counter() - time.process_time()  # the interpreter's own start counts as well, about


def main() -> None:
    """Print one JSON object; every number is the time since the start of the process [s]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="position_setpoint_task")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--no-capture", action="store_true")
    asked = parser.parse_args()
    since: dict[str, object] = {}

    def note(what: str) -> None:
        since[f"{what}_s"] = round(time.perf_counter() - _BEGIN, 2)

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
    print(json.dumps({"task": asked.task, "device": str(task.device), "captured": task.captured, **since}))


if __name__ == "__main__":
    main()
