"""The choice of a torch device by name."""

import torch

from aerial_gym.errors import ConfigError


def resolve_device(name: str | torch.device) -> torch.device:
    """Return the torch device of a name; ``auto`` and ``cuda`` take torch's current GPU, which is the first by default.

    ``auto`` takes the CPU if there is no GPU.

    Raises:
        ConfigError: If the name is no device, or names a missing GPU.
    """
    if str(name) == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ConfigError(f"device {name!r}: must be auto, cpu, cuda or cuda:N") from None
    if device.type == "cuda":
        count = torch.cuda.device_count()
        chosen = torch.cuda.current_device() if torch.cuda.is_initialized() else 0  # a query would initialise CUDA
        index = chosen if device.index is None else device.index
        if index >= count:
            raise ConfigError(f"device {str(name)!r}: this machine shows {count} CUDA devices. Use device='cpu'.")
        return torch.device("cuda", index)
    return plain_device(device)


def plain_device(name: str | torch.device) -> torch.device:
    """Return the torch device of a name as tensors report it: ``cpu:0`` is ``cpu``."""
    device = torch.device(name)
    return torch.device("cpu") if device.type == "cpu" else device
