"""Page of a fleet on this machine: overview, vehicles and flights, read from the fleet's tables."""

from aerial_gym.fleet.page.server import serve

__all__ = ["serve"]
