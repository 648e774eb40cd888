"""The choice of a torch device by name."""

import torch

from aerial_gym.errors import ConfigError


def resolve_device(name: str | torch.device) -> torch.device:
    """Return the torch device of a name; ``auto`` takes the first GPU if there is one.

    Raises:
        ConfigError: If the name asks for a GPU that is not there, or is no device at all.
    """
    if str(name) == "auto":
        return torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ConfigError(f"device {name!r}: must be auto, cpu, cuda or cuda:N") from None
    if device.type == "cuda":
        count = torch.cuda.device_count()
        if (device.index or 0) >= count:
            raise ConfigError(f"device {str(name)!r}: this machine shows {count} CUDA devices. Use device='cpu'.")
        return torch.device("cuda", device.index or 0)
    return device
