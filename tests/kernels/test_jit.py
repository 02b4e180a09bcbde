"""Compiled kernels are kept per state of the sources."""

import os
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


def test_it_is_said_once_and_only_where_a_kernel_is_compiled(tmp_path):
    script = tmp_path / "twice.py"
    script.write_text(
        "import logging\n"
        "from dynmap_cli.compiling import announce_compilation\n"
        "from dynmap_cli.kernels.jit import kernel\n"
        "logging.basicConfig(level=logging.INFO, format='%(message)s')\n"
        "@kernel\n"
        "def one(x): return x + 1\n"
        "@kernel\n"
        "def two(x): return one(x) + 1\n"
        "announce_compilation()\n"
        "announce_compilation()\n"
        "print(two(1), two(1.0))\n"
    )
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": str(ROOM.parents[1]),
    }
    environment.pop("NUMBA_DISABLE_JIT", None)
    environment["DYNMAP_NUMBA_CACHE"] = "1"
    for said in (
        ["compiling kernels, those that this command is the first here to need: up to a minute"],
        [],
    ):
        done = subprocess.run(
            [sys.executable, script], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout == "3 3.0\n"
        assert done.stderr.splitlines() == said
    environment["DYNMAP_NUMBA_CACHE"] = "0"
    done = subprocess.run(
        [sys.executable, script], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr.startswith("compiling kernels, at each call, ")
