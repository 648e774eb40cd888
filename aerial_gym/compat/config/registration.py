"""Registration of script-defined sensor classes in this package's registries."""

import re
from typing import Any

from aerial_gym.registry import Registry


def register_config(cls: Any, cfg: Any, registry: Registry[Any]) -> str:
    """Register a configuration once and return its name: that of an equal entry, else that of its class.

    A class that a script changes after it has been used gets a second name.
    """
    for known in registry:
        if registry.get(known) == cfg:
            return known
    wanted = _snake_case(cls.__name__ if isinstance(cls, type) else type(cls).__name__)
    taken = sum(known == wanted or known.startswith(f"{wanted}_") for known in registry)
    name = f"{wanted}_{taken + 1}" if taken else wanted
    registry.register(name, cfg)
    return name


def _snake_case(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
