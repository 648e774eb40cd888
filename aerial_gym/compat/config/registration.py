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
    class_name = cls.__name__ if isinstance(cls, type) else type(cls).__name__
    snake_case = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", class_name).lower()
    taken = sum(known == snake_case or known.startswith(f"{snake_case}_") for known in registry)
    name = f"{snake_case}_{taken + 1}" if taken else snake_case
    registry.register(name, cfg)
    return name
