"""Commands run as anyone would run them, with the CPU seconds and the peak memory of the whole process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

PROJECT = Path(__file__).resolve().parents[2]
WORLDS = PROJECT / "configs" / "worlds"
SAMPLES = PROJECT / "sample_logs"
_LAUNCHER = Path(__file__).with_name("launcher.py")
T = TypeVar("T")
AT_ONCE = 2
"""Processes that run side by side; CPU seconds are reported, not wall time."""


class FailedError(Exception):
    """A command ended with an error; the message is its last line."""


@dataclass(frozen=True)
class Cost:
    """What a process used."""

    cpu_s: float
    peak_mb: float


def run(words: list[object], *, log: Path) -> Cost:
    """Run a command with one thread and wait for it; raises FailedError with its last line."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    log.parent.mkdir(parents=True, exist_ok=True)
    started = subprocess.run(
        [sys.executable, "-I", "-S", _LAUNCHER, log, *map(str, words)],
        stdout=subprocess.PIPE,
        env=environment,
        cwd=PROJECT,
        check=True,
    )
    exit_code, cpu_s, peak_bytes = json.loads(started.stdout)
    if exit_code != 0:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        raise FailedError(f"exit code {exit_code}: {lines[-1] if lines else 'nothing printed'}")
    return Cost(cpu_s, peak_bytes / 2**20)


def python(*words: object, log: Path) -> Cost:
    """Run this interpreter."""
    return run([sys.executable, *words], log=log)


def dynmap(verb: str, *words: object, log: Path) -> Cost:
    """Run `dynmap VERB ...` as installed beside this interpreter."""
    threads = [] if verb in ("simulate", "export") else ["--threads", 1]
    return run([Path(sys.executable).with_name("dynmap"), verb, *words, *threads, "-q"], log=log)


def stage_seconds(run_dir: Path) -> dict[str, float]:
    """CPU seconds of each stage, from the manifests."""
    manifests = [json.loads(path.read_text()) for path in run_dir.rglob("*.manifest.json")]
    return {manifest["stage"]: float(manifest["seconds"]) for manifest in manifests}


def summary_of(folder: Path, stage: str) -> dict[str, Any]:
    """What a stage said it found."""
    summary: dict[str, Any] = json.loads((folder / f"{stage}.manifest.json").read_text())["summary"]
    return summary


class Jobs:
    """Work that is done once however often it is asked for, two at a time."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(AT_ONCE)
        self._once: dict[tuple[object, ...], Future[Any]] = {}
        self._lock = Lock()

    def start(self, work: Callable[..., T], *args: Any) -> Future[T]:
        """Queue work; it may use `once`, but must not wait for what is queued."""
        return self._pool.submit(work, *args)

    def once(self, key: tuple[object, ...], work: Callable[[], T]) -> T:
        """Do the work, or wait for who does it, or hand out what came of it."""
        with self._lock:
            is_first = key not in self._once
            future = self._once.setdefault(key, Future())
        if is_first:
            started = time.perf_counter()
            try:
                future.set_result(work())
            except Exception as err:
                future.set_exception(err)
            seconds = time.perf_counter() - started
            print(f"{seconds:7.1f} s  {' '.join(map(str, key))}", file=sys.stderr, flush=True)
        return cast("T", future.result())
