"""``aerial-gym bench memory``: memory of an environment with a robot and its sensors, by array."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import FunctionType, MethodType
from typing import TYPE_CHECKING

from aerial_gym.config.set_option import SetOption

if TYPE_CHECKING:
    import torch
    import warp as wp


@dataclass(frozen=True, kw_only=True)
class MemoryBench:
    """Add up the memory of all arrays of a simulator, and on a GPU also what the device lost."""

    env_name: str = "env_with_lidar_nav_obstacles"  # Registered environment
    robot: str = "base_quadrotor_with_camera"  # Registered robot, or a robot file, with its sensors
    num_envs: int = 1024  # Environments side by side
    largest: int = 12  # Number of arrays in the list
    set: SetOption = ()  # Setting of robot, env or sim, such as robot.body.mass=0.3; can be repeated
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given
    device: str = "auto"  # Torch device; auto takes the GPU if there is one
    json: bool = False  # Print one JSON object a line

    def run(self) -> int:
        """Build, reset, step once, add up and print; return the exit status."""
        from aerial_gym.workloads.measure import print_figures

        total, *arrays = self.measure()
        print_figures(total, as_json=self.json)
        if self.json:
            for row in arrays:
                print_figures(row, as_json=True)
        else:
            print_figures({str(row["name"]): row["bytes_per_env"] for row in arrays}, as_json=False)
        return 0

    def measure(self) -> list[dict[str, object]]:
        """Return the total with everything it depends on, then a row for each of the largest arrays."""
        import torch

        from aerial_gym.config.changes import Changes
        from aerial_gym.env_manager import SIMS, SimBuilder
        from aerial_gym.env_manager.sim_builder import environment_by_name
        from aerial_gym.interop import resolve_device
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.workloads.measure import device_name, packages_of_backend, provenance, require_at_least

        require_at_least(1, num_envs=self.num_envs)
        require_at_least(0, largest=self.largest)
        device = resolve_device(self.device)
        free, changes = _free_bytes(device), Changes(self.set)
        sim, scene = (
            changes.apply("sim", SIMS.get("base_sim")),
            changes.apply("env", environment_by_name(self.env_name)),
        )
        robot = changes.apply("robot", robot_by_name(self.robot))
        changes.finish()
        env = SimBuilder().build_env(
            sim_name=sim, env_name=scene, robot_name=robot, controller_name="no_control",
            num_envs=self.num_envs, device=device, backend=self.backend,
        )  # fmt: skip
        env.reset()
        env.step(torch.zeros_like(env.gtd["robot_actions"]))
        env.render()
        taken = None if free is None else free - (_free_bytes(device) or 0)
        arrays = array_bytes(env, device)
        total = sum(arrays.values())
        images = sum(array_bytes([caster.images for caster in env.sensor_manager.casters.values()], device).values())
        figures = {
            "case": "memory", "name": "total", "env_name": self.env_name, "robot": self.robot,
            "backend": self.backend or "auto", "device": device_name(device), "num_envs": self.num_envs,
            "arrays_bytes": total, "images_bytes": images, "images_bytes_per_env": images / self.num_envs,
            "settings": list(self.set), "others_bytes_per_env": (total - images) / self.num_envs, "device_bytes": taken,
            **provenance(*packages_of_backend(self.backend)),
        }  # fmt: skip
        rows = sorted(arrays.items(), key=lambda entry: -entry[1])[: self.largest]
        return [figures, *({"name": name, "bytes": size, "bytes_per_env": size / self.num_envs} for name, size in rows)]


def array_bytes(holder: object, device: "torch.device") -> dict[str, int]:
    """Return the bytes of all torch and Warp arrays on a device that an object holds, by attribute path.

    Views of one memory are counted once, under the name of the widest of them that was found first.
    """
    spans = sorted(_array_spans(holder, device), key=lambda span: (span[0], -span[1]))
    sizes: dict[str, int] = {}
    end = 0
    for begin, stop, name in spans:
        if stop > end:
            sizes[name] = sizes.get(name, 0) + stop - max(begin, end)
            end = stop
    return sizes


def _array_spans(holder: object, device: "torch.device") -> "Iterator[tuple[int, int, str]]":
    """Yield first byte, end and name of every reachable array, breadth first."""
    import torch
    import warp as wp

    waiting, seen = [("", holder)], set()
    for name, thing in waiting:  # grows while it is walked
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        if isinstance(thing, torch.Tensor):
            storage = thing.untyped_storage()
            if thing.device.type == device.type and storage.nbytes():
                yield storage.data_ptr(), storage.data_ptr() + storage.nbytes(), name
        elif isinstance(thing, wp.array):
            place = "none" if thing.device is None else wp.device_to_torch(thing.device)
            if thing.ptr and thing.size and place.startswith(device.type):
                yield thing.ptr, thing.ptr + _array_extent(thing), name
        else:
            waiting += [(f"{name}.{label}".lstrip("."), part) for label, part in _object_parts(thing)]


def _array_extent(array: "wp.array") -> int:
    """Return the bytes from the first element of an array to the end of its last."""
    import warp as wp

    steps = sum((count - 1) * stride for count, stride in zip(array.shape, array.strides, strict=True))
    return steps + wp.types.type_size_in_bytes(array.dtype)


def _object_parts(thing: object) -> Iterator[tuple[str, object]]:
    """Yield name and value of the parts of a container, an object of this package, a function or a recorded launch."""
    import warp as wp

    if isinstance(thing, Mapping):
        yield from ((str(key), value) for key, value in thing.items())
    elif isinstance(thing, (list, tuple)):
        yield from ((str(i), value) for i, value in enumerate(thing))
    elif isinstance(thing, MethodType):
        yield "", thing.__self__
    elif isinstance(thing, FunctionType):
        yield from ((thing.__name__, cell.cell_contents) for cell in thing.__closure__ or () if cell.cell_contents)
    elif isinstance(thing, wp.Launch):
        yield "launch", thing.fwd_args
    elif isinstance(thing, wp.Mesh) or hasattr(thing, "_ctype") or type(thing).__module__.startswith("aerial_gym"):
        yield from getattr(thing, "__dict__", {}).items()


def _free_bytes(device: "torch.device") -> int | None:
    """Return the free memory of a GPU after emptying torch's cache; None for a CPU."""
    import torch

    if device.type != "cuda":
        return None
    torch.cuda.synchronize(device)
    torch.cuda.empty_cache()
    return torch.cuda.mem_get_info(device)[0]
