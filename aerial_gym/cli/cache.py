"""``aerial-gym cache``: the folders in which compiled code is kept."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from aerial_gym.cli.process import bytecode_folder
from aerial_gym.cli.terminal import print_table
from aerial_gym.config.console import json_line
from aerial_gym.errors import ConfigError, suggest_name


@dataclass(frozen=True, kw_only=True)
class Cache:
    """A folder with compiled code, which is compiled again if it is missing."""

    content: str  # What the folder holds
    folder: Path
    clear: Callable[[], None]  # Removes the content

    def entry(self) -> dict[str, str | int]:
        """Return folder, content, number of files and size."""
        files = [path for path in self.folder.rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files)
        return {"folder": str(self.folder), "content": self.content, "num_files": len(files), "size_bytes": size}


def find_caches() -> dict[str, Cache]:
    """Return the caches by name; starts Warp, which knows the folder of its kernels."""
    import warp as wp

    from aerial_gym.interop.warp_start import start_warp

    start_warp()

    def clear_kernels() -> None:
        wp.clear_kernel_cache()
        wp.clear_lto_cache()

    kernels = Path(str(wp.config.kernel_cache_dir))
    from aerial_gym.firmware.compiler import cache_folder

    def remove(folder: Path) -> Callable[[], None]:
        return lambda: shutil.rmtree(folder, ignore_errors=True)

    bytecode, firmware = bytecode_folder(), cache_folder()
    return {
        "kernels": Cache(content="kernels that Warp compiled", folder=kernels, clear=clear_kernels),
        "bytecode": Cache(content="Python bytecode", folder=bytecode, clear=remove(bytecode)),
        "firmware": Cache(content="firmware built by sitl", folder=firmware, clear=remove(firmware)),
    }


def cache_rows(caches: dict[str, dict[str, str | int]]) -> list[tuple[str, ...]]:
    """Return the rows of a table of caches: name, number of files, size, folder."""
    return [
        (name, f"{entry['num_files']:,} files", f"{int(entry['size_bytes']) / 1e6:.1f} MB", str(entry["folder"]))
        for name, entry in caches.items()
    ]


@dataclass(frozen=True, kw_only=True)
class ListCachesCmd:
    """List the caches of compiled code with their folders and sizes."""

    json: bool = False  # Print one JSON object instead of a table

    def run(self) -> int:
        """Print one line for each cache."""
        entries = {name: cache.entry() for name, cache in find_caches().items()}
        if self.json:
            print(json_line(entries, indent=2))
        else:
            print_table(cache_rows(entries))
        return 0


@dataclass(frozen=True, kw_only=True)
class ClearCachesCmd:
    """Remove compiled code; the next command compiles what it needs, which takes some seconds."""

    names: Annotated[
        tuple[str, ...], tyro.conf.Positional
    ] = ()  # Caches to clear: kernels, bytecode or firmware; all if not given

    def run(self) -> int:
        """Clear the caches and print the size of each."""
        caches = find_caches()
        unknown = [name for name in self.names if name not in caches]
        if unknown:
            known = f" Known: {', '.join(caches)}"
            raise ConfigError(*(f"no cache {name!r}.{suggest_name(name, caches)}{known}" for name in unknown))
        for name in self.names or caches:
            before = caches[name].entry()
            caches[name].clear()
            print_table(cache_rows({f"cleared {name}": before}))
        return 0
