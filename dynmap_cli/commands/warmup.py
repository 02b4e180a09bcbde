"""`dynmap warmup`: compile everything now, so that the first real recording does not wait for it."""

from __future__ import annotations

from pathlib import Path

import click

from dynmap_cli.commands.options import Shared, print_summary, shared_options

_ROOM = """
about: A room of 6 m x 4 m, open to the east, with a door and a box that come and go, passed four times.
seed: 1
world:
  walls:
    - [[2.6, 0], [0, 0], [0, 4], [2, 4], [2, 3.6], [2.4, 3.6], [2.4, 4], [6, 4]]
    - [[5.4, 1.0], [5.4, 0], [3.6, 0]]
    - [[2.6, 0], [2.0, 0], [2.0, -2.5], [4.4, -2.5], [4.4, 0], [3.6, 0]]
  doors:
    - {name: door, hinge: [2.6, 0], latch: [3.6, 0], states: {closed: 0, open: -90},
       schedule: [[0, closed], [50, open], [130, closed], [205, open]]}
  boxes:
    - {name: box, size_m: [0.6, 0.4], places: {corner: [0.5, 3.2, 0]}, absent: true,
       schedule: [[0, corner], [50, absent], [130, corner], [205, absent]]}
movers:
  - {does: walk, path: [[0.6, 2.8], [5.4, 2.9]], speed_mps: 1.0}
robot: {path: [[1.0, 1.5], [4.4, 1.4], [4.4, 2.4], [1.0, 2.2], [1.0, 1.5]], repeat: 4, pause_s: 60,
        speed_mps: 0.6, turn_rate_degps: 40}
lasers: [{beams: 121, fov_deg: 240, max_range_m: 8, rate_hz: 3}]
"""


@click.command("warmup", short_help="Compile everything now, so that no command waits.")
@shared_options
def command(shared: Shared) -> None:
    """Compile all kernels now, on a small simulated recording, so that no later command has to wait.

    Run it once after installing: it moves compilation from the first command to install time.
    """
    import tempfile
    import time

    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="dynmap-warmup-") as name:
        _run_the_whole_chain(Path(name), shared)
    seconds = round(time.perf_counter() - started, 1)
    print_summary(
        {"seconds": seconds},
        [f"all kernels are compiled, after {seconds:.1f} s of a trial run"],
        as_json=shared.as_json,
    )


def _run_the_whole_chain(folder: Path, shared: Shared) -> None:
    """Simulate, build, localize; what is written is thrown away."""
    import numpy as np

    from dynmap_cli.ingest.settings import IngestSettings
    from dynmap_cli.localization.particles.motion import updated_velocity
    from dynmap_cli.runs.finished import localize
    from dynmap_cli.runs.pipeline import build
    from dynmap_cli.simulation.stage import simulate_to_files

    scenario, recording = folder / "room.yaml", folder / "room.mcap"
    scenario.write_text(_ROOM, encoding="ascii")
    simulate_to_files(scenario, recording)
    looking_back = shared.config.localization.model_copy(update={"smooth": True})
    config = shared.config.model_copy(
        update={"ingest": IngestSettings(), "localization": looking_back}
    )  # topics of a robot are not those here
    # The sums of several threads are joined by a kernel of their own.
    build(folder / "run", [recording], config, threads=max(2, shared.threads))
    for sensor, ingest in (("likelihood_field", IngestSettings()), ("beam", IngestSettings(odom="none"))):
        weighed = config.localization.model_copy(update={"sensor": sensor})
        chosen = config.model_copy(update={"ingest": ingest, "localization": weighed})
        localize(folder / "run", [recording], folder / sensor, chosen, threads=shared.threads, force=False)
    # Only needed where neither wheels nor scans tell how the robot moved, as they do in this room.
    updated_velocity(np.zeros(3), np.zeros((2, 3)), np.zeros((2, 3)), np.full(2, 0.5), 1.0)
