"""What a stage is: a record of the files it reads and writes, and the work."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynmap_cli.config import Config


@dataclass(frozen=True, slots=True)
class StageContext:
    """What the work of a stage is given.

    Attributes
    ----------
    run_dir : Path
        Where the files of earlier stages are read.
    out_dir : Path
        Empty folder for the files of this stage; it becomes `<run_dir>/<stage.folder>` when all is well.
    config : Config
    recordings : tuple of Path
        The recordings, for the stage that reads them; empty for the others.
    threads : int
        How many threads may be used; results never depend on it.
    scans_dir : Path
        The folder of scan columns: that of the run, or of the recording that is localized in it.
    map_yaml : Path or None
        A map_server map to localize in, instead of the run's own maps.
    earlier_scans : Path or None
        Columns of recordings that were read before, to which the recordings are added.
    beside : tuple of Path
        Further files that the work reads.
    options : mapping of str to Any
        Plain values of options that are no settings, and that the result depends on, by their names (`--states`).
    """

    run_dir: Path
    out_dir: Path
    config: Config
    recordings: tuple[Path, ...]
    threads: int
    scans_dir: Path
    map_yaml: Path | None = None
    earlier_scans: Path | None = None
    beside: tuple[Path, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Stage:
    """One step: the files it reads, the files it writes, and the work.

    Attributes
    ----------
    name : str
        The verb, for instance "map".
    title : str
        What it does, in a few words, for progress lines.
    section : str
        The section of the settings it depends on.
    folder : str
        The folder in the run it fills; "" = the run itself.
    reads, writes : tuple of str
        Paths within the run; folders that hold a varying number of files end in "/".
    run : callable
        Does the work and returns the summary, plain numbers and words; its entry "lines" is a list of
        sentences for people that say what was found.
    seeded : bool
        Whether the result depends on the seed.
    has_kernels : bool
        Whether compiled kernels do its work; loading the compiler takes 0.5 s and 60 MB.
    needs : callable or None
        Says for what it needs room on the disk and how many bytes; None = it looks itself, or writes little.
    """

    name: str
    title: str
    section: str
    folder: str
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    run: Callable[[StageContext], dict[str, Any]]
    seeded: bool = False
    has_kernels: bool = True
    needs: Callable[[StageContext], tuple[str, int]] | None = None
