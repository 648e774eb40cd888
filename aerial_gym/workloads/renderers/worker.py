# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
"""The process of one peer: ``python worker.py NAME SCENE.npz IMAGES.npz``, run by the interpreter that has the peer.

Nothing of ours is imported, so that the peer's interpreter needs none of it: this folder is the first place where Python
looks for the peer's file. Each ``peer_NAME.py`` has ``make_renderer(scene, device)``, which returns a call that draws all
images and one that returns them, and ``PACKAGES``, whose versions are printed.

A scene is a dictionary of arrays. Letters: E environments, P parts, H x W pixels.
    kind (P,) box, sphere, cylinder, or floor (a rectangle seen from above); size (P, 3) edges, radius, or radius and height [m]
    position (E, P, 3) [m], attitude (E, P, 4) part to world, xyzw; identity (P,) what segmentation shows
    camera_position (E, 3) [m], camera_attitude (E, 4) camera to world, xyzw; a camera looks along its own x, y is left
    direction (H, W, 3) of the rays, unit, camera frame; vfov_deg; segmentation, bool
Images: depth along the optical axis [m], -1 for a miss, (E, H, W); identities, -2 for a miss, (E, H, W), or None.
"""

import argparse
import importlib
import json
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

import numpy as np

CALLS = 4  # Calls in one CUDA graph, and between two looks at the clock
WARM_UP_CALLS = 3  # Calls before a capture, which must find every kernel compiled


def main() -> None:
    """Build the scene, write the images, print the time of one call in each repeat."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("scene")
    parser.add_argument("images")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--repeat-time-s", type=float, default=0.5)
    asked = parser.parse_args()
    peer = importlib.import_module(f"peer_{asked.name}")
    draw, images = peer.make_renderer(dict(np.load(asked.scene)), asked.device)
    run, wait = make_batch(draw, asked.device)
    run()
    depth, identity = images()
    np.savez(asked.images, depth=depth, **({} if identity is None else {"identity": identity}))
    seconds = measure(run, wait, repeats=asked.repeats, repeat_time_s=asked.repeat_time_s)
    print(json.dumps({"seconds": seconds, "versions": {name: package_version(name) for name in peer.PACKAGES}}))


def package_version(package: str) -> str:
    """Return the version of a package, from its metadata or its module."""
    try:
        return version(package)
    except PackageNotFoundError:
        module = importlib.import_module(package.removesuffix("-lang").replace("-", "_"))
        return str(getattr(module, "__version__", "unknown"))


def make_batch(draw: Callable[[], None], device: str) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return two functions: one makes ``CALLS`` calls (on a GPU the replay of a graph), one waits for them."""
    if device == "cpu":
        return lambda: repeat(draw, CALLS), lambda: None
    import warp as wp

    with wp.ScopedDevice(device):
        repeat(draw, WARM_UP_CALLS)
        with wp.ScopedCapture() as capture:
            repeat(draw, CALLS)
    graph = capture.graph
    assert graph is not None
    return lambda: wp.capture_launch(graph), lambda: wp.synchronize_device(device)


def repeat(call: Callable[[], None], times: int) -> None:
    """Call so many times."""
    for _ in range(times):
        call()


def measure(run: Callable[[], None], wait: Callable[[], None], *, repeats: int, repeat_time_s: float) -> list[float]:
    """Return the mean time of a call in each repeat [s]."""

    def time_runs(count: int) -> float:
        wait()
        begin = time.perf_counter()
        for _ in range(count):
            run()
        wait()
        return time.perf_counter() - begin

    count = 1
    while (elapsed := time_runs(count)) < 0.2 * repeat_time_s:
        count *= 4
    count = max(1, round(count * repeat_time_s / elapsed))
    return [time_runs(count) / (count * CALLS) for _ in range(repeats)]


if __name__ == "__main__":
    main()
