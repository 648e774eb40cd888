"""The commands of ``aerial-gym`` by ``python -m aerial_gym``."""

from aerial_gym.cli.main import entry

if __name__ == "__main__":
    entry()
