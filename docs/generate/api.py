"""Pages of the Python interface: one directive for each public package."""

from docs.generate.markdown import page

PACKAGES = (
    "aerial_gym",
    "aerial_gym.config",
    "aerial_gym.registry",
    "aerial_gym.physics",
    "aerial_gym.assets",
    "aerial_gym.control",
    "aerial_gym.sensors",
    "aerial_gym.robots",
    "aerial_gym.env_manager",
    "aerial_gym.task",
    "aerial_gym.rl_training",
    "aerial_gym.sim2real",
    "aerial_gym.export",
)
"""Packages whose ``__all__`` is public."""

INTRODUCTION = "For programmers: the public names of this package. Names that are not listed may change in any release."


def api_pages() -> dict[str, str]:
    """Return the pages by their path below ``reference/``."""
    return {f"api/{name}.md": page(f"Package `{name}`", INTRODUCTION, [f"::: {name}"]) for name in PACKAGES}
