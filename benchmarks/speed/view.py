"""``python -m benchmarks.speed.view``: scene updates per second that a page receives, with the simulation in the same process.

The client is a process of its own, which decodes the messages of the websocket as a browser does. With ``--training`` it
measures what ``train --view`` costs instead: pairs of trainings with and without a page, in alternating order, each in a
process of its own. With ``--device cuda --num-envs 4096`` that is the figure of the limit of 2 %.
"""

import argparse
import json
import multiprocessing
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

NODE = "/others/blades"  # Of which every update has the rotors of all vehicles but one
PORT = 8090


def measure_page(num_envs: int, duration_s: float) -> dict[str, object]:
    """Return the rate at which a client receives the poses of all vehicles, and that of the simulation's updates."""
    from aerial_gym.env_manager import SimBuilder
    from aerial_gym.viewer.live import LiveView
    from aerial_gym.viewer.server import close_server, open_server
    from aerial_gym.viewer.simulation import FlightInView
    from tests.unit.viewer.client import count_updates

    env = SimBuilder().build_env(
        sim_name="base_sim", env_name="empty_env", robot_name="base_quadrotor", controller_name="lee_position_control",
        num_envs=num_envs, device="cpu", seed=0,
    )  # fmt: skip
    server = open_server(port=0)
    view = LiveView(server, FlightInView(env))
    flying = threading.Thread(target=view.run)
    flying.start()
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        start, sent = time.perf_counter(), view.num_updates
        count, span = pool.apply(count_updates, (server.get_port(), NODE, duration_s))
        sent_per_s = (view.num_updates - sent) / (time.perf_counter() - start)
    view.ends.set()
    flying.join()
    close_server(server)
    steps = float(env.gtd["sim_steps"][0])
    return {
        "num_envs": num_envs, "received_per_s": count / span, "sent_per_s": sent_per_s, "flight_time_s": steps * env.dt,
    }  # fmt: skip


def _steps_per_s(num_envs: int, device: str, time_s: float, *, view: bool) -> float:
    """Return the steps per second of one training in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable, "-m", "aerial_gym", "train", "--out", str(Path(folder) / "run"), "--num-envs", str(num_envs),
            "--device", device, "--max-time-s", str(time_s), "--json", *(["--view", "--port", str(PORT)] if view else []),
        ]  # fmt: skip
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        rate = float(json.loads(done.stdout.splitlines()[-1])["env_steps_per_s"])
    if rate <= 0.0:
        raise SystemExit(f"a training of {time_s:g} s made one report at most. Give more time: --time-s")
    return rate


def measure_training(num_envs: int, device: str, time_s: float, pairs: int) -> dict[str, object]:
    """Return the ratio of the speeds with and without a page, of alternating pairs; the first pair compiles and is dropped."""
    ratios = []
    for number in range(pairs + 1):
        order = (True, False) if number % 2 else (False, True)
        rates = {view: _steps_per_s(num_envs, device, time_s, view=view) for view in order}
        ratios.append(rates[True] / rates[False])
        print(f"{rates[False]:,.0f} steps/s, with a page {rates[True]:,.0f}: {ratios[-1]:.4f}", file=sys.stderr)
    kept = ratios[1:]
    return {
        "num_envs": num_envs, "device": device, "pairs": pairs, "slower_percent": 100.0 * (1.0 - statistics.median(kept)),
        "least_percent": 100.0 * (1.0 - max(kept)), "most_percent": 100.0 * (1.0 - min(kept)),
    }  # fmt: skip


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--training", action="store_true", help="measure the cost of train --view")
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--time-s", type=float, default=20.0, help="length of a measurement or of a training [s]")
    parser.add_argument("--pairs", type=int, default=5)
    asked = parser.parse_args()
    if asked.training:
        print(json.dumps(measure_training(asked.num_envs, asked.device, asked.time_s, asked.pairs)))
    else:
        print(json.dumps(measure_page(asked.num_envs, asked.time_s)))


if __name__ == "__main__":
    main()
