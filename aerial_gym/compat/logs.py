"""The logger of the Aerial Gym Simulator's scripts: a standard logger, set up by ``logging.basicConfig`` as any other.

There it sets up a handler of its own; here warnings are shown until the script asks for more.
"""

import logging


class CustomLogger(logging.LoggerAdapter):
    """A logger by name; ``print_example_message`` greets from an example."""

    def __init__(self, logger_name: str) -> None:
        super().__init__(logging.getLogger(logger_name), {})

    def setLoggerLevel(self, level: int | str) -> None:  # noqa: N802 (their name)
        """Set the lowest level that is shown."""
        self.logger.setLevel(level)

    def print_example_message(self) -> None:
        """Say that an example begins."""
        self.info("An example in the manner of the Aerial Gym Simulator; see docs/guides/coming_from_aerial_gym.md")
