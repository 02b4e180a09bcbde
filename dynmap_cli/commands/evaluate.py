"""`dynmap evaluate`: results against truth, as a table, JSON or a figure."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynmap_cli.commands.options import MAX_SEED, MAX_THREADS, PATH, print_summary, set_up_logging

if TYPE_CHECKING:
    from dynmap_cli.evaluation.scores import Score

Function = Callable[..., Any]
Plot = Callable[[Path, Sequence["Score"]], None]


@click.group("evaluate", short_help="Measure results against a truth.")
def command() -> None:
    """Measure results against truth, references or relations.

    Several pairs in one call are several columns, with the mean and its bootstrapped 5 and 95 % band.
    A result that answers less than 99 % of what was asked for is INCOMPLETE and makes every mean void,
    but exits with 0; one of which nothing could be compared exits with 4.
    """


def output_options(function: Function) -> Function:
    """Add --json, --plot, --seed, -v and -q; the body returns scores and how to plot them."""

    @click.option("--json", "as_json", is_flag=True, help="Write JSON to stdout.")
    @click.option("--plot", "plot_path", metavar="FILE.png", type=PATH, help="Draw a figure as well.")
    @click.option(
        "--seed",
        metavar="N",
        type=click.IntRange(0, MAX_SEED),
        default=0,
        help="Seed of the bootstrap (default 0).",
    )
    @click.option("-v", "--verbose", count=True, help="More lines on stderr.")
    @click.option(
        "-q", "--quiet", is_flag=True, help="Only warnings and errors on stderr; stdout stays as it is."
    )
    @functools.wraps(function)
    def wrapper(
        *args: Any, as_json: bool, plot_path: Path | None, seed: int, verbose: int, quiet: bool, **kwargs: Any
    ) -> None:
        set_up_logging(verbose, quiet=quiet)
        scores, plot, more_lines = function(*args, **kwargs)
        from dynmap_cli.evaluation.scores import as_lines, as_record

        lines = [*as_lines(scores, seed), *more_lines]
        print_summary(as_record(scores, seed), lines, as_json=as_json)
        if plot_path is not None:
            plot(plot_path, scores)
        _refuse_nothing(scores)

    return wrapper


def _refuse_nothing(scores: Sequence[Score]) -> None:
    """A result of which nothing could be compared is most often one of something else."""
    from dynmap_cli.errors import LogError

    names = [score.name for score in scores if score.coverage == 0.0]
    if names:
        msg = f"{', '.join(names)}: nothing could be compared. Do both files belong to the same recording?"
        raise LogError(msg)


def named_pairs(paths: Sequence[Path], first: str, second: str) -> list[tuple[str, Path, Path]]:
    """Take arguments two by two, each result with its name and what it is held against."""
    if not paths or len(paths) % 2:
        msg = f"expected pairs of {first} {second}, found {len(paths)} arguments"
        raise click.UsageError(msg)
    results, references = paths[::2], paths[1::2]
    return list(zip(short_names(results), results, references, strict=True))


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name each result by what tells it from the others."""
    stems = [_stem(path) for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return [str(path) for path in paths]


def _stem(path: Path) -> str:
    """Name of the run where the file is one of a run's own."""
    if path.name in {"trajectory.tum", "map.yaml"}:
        folder = path.absolute().parent
        return (folder.parent.name if folder.name == "map" else folder.name).split(".")[0]
    return path.name.split(".")[0]


@command.command("relations")
@click.argument("paths", metavar="[TRAJECTORY.tum RELATIONS]...", nargs=-1, required=True, type=PATH)
@output_options
def relations_command(paths: tuple[Path, ...]) -> tuple[list[Score], Plot, list[str]]:
    """Compare motions with relations that were checked by hand (Kuemmerle's metric)."""
    from dynmap_cli.evaluation.figures import plot_distributions
    from dynmap_cli.evaluation.relations import published_line, read_relations, score_relations
    from dynmap_cli.files.trajectory import read_tum

    scores = [
        score_relations(name, read_tum(trajectory), read_relations(relations))
        for name, trajectory, relations in named_pairs(paths, "TRAJECTORY.tum", "RELATIONS")
    ]
    return scores, plot_distributions, ["", *map(published_line, scores)]


@command.command("trajectory")
@click.argument("paths", metavar="[ESTIMATE.tum REFERENCE.tum]...", nargs=-1, required=True, type=PATH)
@output_options
def trajectory_command(paths: tuple[Path, ...]) -> tuple[list[Score], Plot, list[str]]:
    """Absolute and relative trajectory error (ATE, RPE) after alignment without scale."""
    from dynmap_cli.evaluation.figures import plot_paths
    from dynmap_cli.evaluation.trajectories import read_reference, score_trajectory
    from dynmap_cli.files.trajectory import read_tum

    scores = [
        score_trajectory(name, read_tum(estimate), read_reference(reference))
        for name, estimate, reference in named_pairs(paths, "ESTIMATE.tum", "REFERENCE.tum")
    ]
    return scores, plot_paths, []


@command.command("beams")
@click.argument("paths", metavar="[RUN TRUTH]...", nargs=-1, required=True, type=PATH)
@click.option(
    "--threads",
    metavar="N",
    type=click.IntRange(1, MAX_THREADS),
    default=1,
    help="Threads to use (default 1).",
)
@output_options
def beams_command(paths: tuple[Path, ...], threads: int) -> tuple[list[Score], Plot, list[str]]:
    """Compare the label of every beam with what it really hit; two ablations at the same poses beside it.

    TRUTH is the folder LOG.truth that `dynmap simulate` writes.
    """
    from dynmap_cli.evaluation.beams import score_beams
    from dynmap_cli.evaluation.figures import plot_bars
    from dynmap_cli.evaluation.truth import read_run, read_truth

    scores = [
        score_beams(name, read_run(run), read_truth(truth), threads=threads)
        for name, run, truth in named_pairs(paths, "RUN", "TRUTH")
    ]
    names = ("static_kept_SA", "dynamic_found_DA", "harmonic_HA", "precision", "F1")
    return scores, functools.partial(plot_bars, names=names, label="share"), []


@command.command("states")
@click.argument("paths", metavar="[RUN TRUTH]...", nargs=-1, required=True, type=PATH)
@output_options
def states_command(paths: tuple[Path, ...]) -> tuple[list[Score], Plot, list[str]]:
    """Compare states and objects of each sub-map with what the doors and boxes in it really did."""
    from dynmap_cli.evaluation.figures import plot_bars
    from dynmap_cli.evaluation.objects import score_run
    from dynmap_cli.evaluation.truth import read_truth

    scores = [
        score_run(name, run, read_truth(truth)) for name, run, truth in named_pairs(paths, "RUN", "TRUTH")
    ]
    names = ("objects_found_share", "adjusted_rand_index", "right_number_of_states_share")
    return scores, functools.partial(plot_bars, names=names, label="share"), []


@command.command("localization")
@click.argument("paths", metavar="[OUT TRUTH]...", nargs=-1, required=True, type=PATH)
@click.option(
    "--map",
    "map_paths",
    metavar="RUN TRUTH",
    nargs=2,
    type=PATH,
    help="The run it was localized in and the truth of that run's recording: gives the frame of the map and the "
    "meaning of its states. Without it, poses are taken to be in the frame of the truth.",
)
@output_options
def localization_command(
    paths: tuple[Path, ...], map_paths: tuple[Path, Path] | None
) -> tuple[list[Score], Plot, list[str]]:
    """Compare poses, states and verdicts of a localization with the truth of its recording.

    A pose is right within 0.5 m and 10 degrees; success = 95 % right after convergence.
    """
    from dynmap_cli.evaluation.figures import plot_over_time
    from dynmap_cli.evaluation.localization import read_localized, score_localization
    from dynmap_cli.evaluation.object_beliefs import read_object_shares
    from dynmap_cli.evaluation.states import read_learned_states
    from dynmap_cli.evaluation.truth import read_truth

    learned = map_truth = shares = None
    if map_paths is not None:
        map_truth = read_truth(map_paths[1])
        learned = read_learned_states(map_paths[0], map_truth)
        shares = read_object_shares(map_paths[0], map_truth)
    scores = [
        score_localization(name, read_localized(out), read_truth(truth), learned, map_truth, shares)
        for name, out, truth in named_pairs(paths, "OUT", "TRUTH")
    ]
    hints = []
    if map_paths is None and not all(score.values["success"] for score in scores):
        hints = [
            "",
            "Poses were taken to be in the frame of the truth; pass --map RUN TRUTH if the map has another.",
        ]
    return scores, plot_over_time, hints


@command.command("map")
@click.argument("paths", metavar="[MAP REFERENCE]... | RUN...", nargs=-1, required=True, type=PATH)
@output_options
def map_command(paths: tuple[Path, ...]) -> tuple[list[Score], Plot, list[str]]:
    """Compare maps with references after alignment, or measure runs without any.

    MAP and REFERENCE are map_server YAML files. If all arguments are run directories, each is measured on its own:
    thickness of its walls, likelihood of scans held out, share of the end points that other scans look through.
    """
    from dynmap_cli.evaluation.figures import plot_bars
    from dynmap_cli.evaluation.maps import score_map
    from dynmap_cli.evaluation.sharpness import score_alone
    from dynmap_cli.evaluation.truth import read_run
    from dynmap_cli.files.pgm import read_map

    if all(path.is_dir() for path in paths):
        scores = [
            score_alone(name, read_run(run)) for name, run in zip(short_names(paths), paths, strict=True)
        ]
        shares = ("looked_through_share", "looked_through_share_of_kept", "removed_share")
        return scores, functools.partial(plot_bars, names=shares, label="share"), []
    scores = [
        score_map(name, read_map(found)[0], read_map(reference)[0])
        for name, found, reference in named_pairs(paths, "MAP.yaml", "REFERENCE.yaml")
    ]
    names = ("differing_share", "occupied_precision", "occupied_recall", "occupied_recall_where_seen")
    return scores, functools.partial(plot_bars, names=names, label="share"), []
