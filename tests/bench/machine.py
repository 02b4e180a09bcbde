"""On what the numbers were measured."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tests.bench.measured import PROJECT

_PACKAGES = ("dynmap", "numpy", "numba", "scipy", "rosbags", "mcap", "yag-slam", "amcl")


def describe() -> list[str]:
    """Lines about machine, versions and date."""
    installed = ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    return [
        f"- machine: {os.cpu_count()} cores, {_cpu_model()}, {platform.system()} {platform.machine()}",
        f"- versions: Python {platform.python_version()}, {installed}; commit {_commit()}",
        f"- date: {datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
    ]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(not installed)"


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="ascii").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown CPU"


def _commit() -> str:
    words = ["git", "-C", str(PROJECT), "describe", "--always", "--dirty"]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    return found.stdout.strip() or "unknown"
