"""Damages samples and reads them, with Hypothesis."""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st

from tests.fuzz.law import obey
from tests.fuzz.mutations import Edit, damaged, edits
from tests.fuzz.targets import Target


def read_damaged(target: Target, name: str, damages: Sequence[Edit]) -> None:
    """Damage one file of a sample, read the sample, and hold the reader to the law."""
    files = target.sample()
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        target.write(folder, {**files, name: damaged(files[name], damages)})
        obey(target.read, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def fuzz(target: Target, examples: int, first_seed: int | None = None) -> None:
    """Try so many damages; what breaks the law comes out as Hypothesis has it, made small.

    With a *first_seed* the damages are others at every seed; without they are always the same.
    """
    files = target.sample()

    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=first_seed is None,
        report_multiple_bugs=False,
        verbosity=Verbosity.normal,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def law(data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(files)), label="file")
        damages = data.draw(edits(len(files[name])), label="damages")
        read_damaged(target, name, damages)

    if first_seed is not None:
        law = seed(first_seed)(law)
    law()


def new_seed(draw: random.Random) -> int:
    """A number that can be passed again to see the same."""
    return draw.randrange(1 << 32)
