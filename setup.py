"""Build of the package; all settings stand in ``pyproject.toml``."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithPlant(build_py):
    """Add the plant that simulates the flights of ``aerial-gym demo``. It stays outside ``aerial_gym``, with which it shares no
    code, so that a wheel has a copy of it."""

    def run(self) -> None:
        """Copy the package, then the plant."""
        super().run()
        if self.editable_mode:
            return
        for file in ("benchmarks/__init__.py", *Path().glob("benchmarks/undeclared/*.py")):
            target = Path(self.build_lib, "aerial_gym/cli/demo/plant", file)
            self.mkpath(str(target.parent))
            self.copy_file(str(file), str(target))


setup(cmdclass={"build_py": BuildWithPlant})
