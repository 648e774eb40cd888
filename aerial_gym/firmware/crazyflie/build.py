"""Build of one controller of the Crazyflie's firmware as a host library, from the user's checkout; takes seconds."""

import os
from collections.abc import Mapping
from pathlib import Path

from aerial_gym.errors import ConfigError
from aerial_gym.firmware.compiler import compile_library, require_programs

VARIABLE = "CRAZYFLIE_BASE"  # Environment variable with the checkout. Source: its own makefiles, `oot.mk`
FUNCTIONS = {
    "pid": "controllerPid", "mellinger": "controllerMellingerFirmware", "indi": "controllerINDI",
    "brescianini": "controllerBrescianini", "lee": "controllerLeeFirmware",
}  # fmt: skip
"""Functions of the controllers by name. Source: ``controller.c``."""

SOURCES = (
    "modules/src/power_distribution_quadrotor.c", "modules/src/controller/attitude_pid_controller.c",
    "modules/src/controller/position_controller_pid.c", "utils/src/filter.c", "utils/src/num.c", "utils/src/pid.c",
)  # fmt: skip
FURTHER = {"indi": ("modules/src/controller/position_controller_indi.c",), "mellinger": ("modules/src/pptraj.c",)}


def find_checkout(given: str | Path | None = None) -> Path:
    """Return the checkout of the firmware, else that of ``VARIABLE``; raise ``ConfigError`` if there is none."""
    path = Path(given or os.environ.get(VARIABLE, ""))
    if not (path / "src" / SOURCES[0]).is_file():
        place = f"in {path}" if given or VARIABLE in os.environ else "given"
        raise ConfigError(
            f"sitl crazyflie: no firmware of the Crazyflie {place}. Clone github.com/bitcraze/crazyflie-firmware, and give its "
            f"folder by --firmware or the variable {VARIABLE}"
        )
    return path.resolve()


def build_controller(name: str, checkout: Path, folder: Path, constants: Mapping[str, float]) -> Path:
    """Return the library of a controller, one of ``FUNCTIONS``, compiled into ``folder``.

    Args:
        constants: In place of those in ``platform_defaults.h``, by name.

    Raises:
        ConfigError: If there is no such controller, or the checkout lacks its source.
        CapabilityError: If the compiler fails.
    """
    require_programs("the firmware of the Crazyflie", "gcc")
    root = checkout / "src"
    sources = [f"modules/src/controller/controller_{name}.c", *SOURCES, *FURTHER.get(name, ())]
    if missing := [each for each in sources if name not in FUNCTIONS or not (root / each).is_file()]:
        raise ConfigError(f"controller {name!r}: {root / missing[0]} is missing. Take one of {', '.join(FUNCTIONS)}")
    folders = sorted({header.parent for header in root.rglob("*.h")})
    (folder / "autoconf.h").touch()  # No options: a Crazyflie 2.x
    own = Path(__file__).parent
    options = [f"-idirafter{each}" for each in (folder, *folders)]
    options += [f"-D{each}" for each in ("UNIT_TEST_MODE", "CRAZYFLIE_FW", "CONFIG_PLATFORM_CF2")]
    options += [f"-D{name}={value!r}f" for name, value in constants.items()]
    options += [f"-DCONTROLLER={FUNCTIONS[name]}", f"-DCONTROLLER_INIT={FUNCTIONS[name]}Init"]
    options += ["-include", str(own / "parameters.h"), str(own / "host.c"), *(str(root / each) for each in sources)]
    library = folder / f"{name}.so"
    compile_library([*options, "-lm"], library)
    return library
