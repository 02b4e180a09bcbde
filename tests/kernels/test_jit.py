"""Compiled kernels are kept per state of the sources."""

import shutil
import subprocess
import sys
from pathlib import Path

ROOM = Path(__file__).parents[2] / "dynmap_cli" / "kernels"
CODE = "import numba, dynmap_cli.kernels.jit; print(numba.config.CACHE_DIR)"


def cache_folder(package_parent):
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=package_parent, capture_output=True, text=True, check=True
    )
    return Path(done.stdout.strip())


def test_a_change_in_any_kernel_file_takes_another_cache(tmp_path):
    room = tmp_path / "dynmap_cli" / "kernels"
    shutil.copytree(ROOM, room, ignore=shutil.ignore_patterns("__pycache__"))
    (room.parent / "__init__.py").write_text("")
    before = cache_folder(tmp_path)
    assert before.parent == room / "__pycache__"
    assert cache_folder(tmp_path) == before
    (room / "matching.py").write_text((room / "matching.py").read_text() + "\nCHANGED = 1\n")
    assert cache_folder(tmp_path) != before
