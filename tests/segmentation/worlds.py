"""Small changing worlds for the rooms that learn from change."""

import numpy as np

from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.simulation.run import simulate
from dynmap_cli.simulation.scenario import parse_scenario

RESOLUTION_M = 0.05


def corridor(*, doors=(), boxes=(), movers=(), repeat=6, beams=121, rate_hz=4, seed=1):
    """Run of a robot that drives to and fro in a corridor of 12 x 2 m with niches; a way takes about 28 s."""
    walls = [
        [[0, 0], [1, 0], [1, -0.4], [1.6, -0.4], [1.6, 0], [3, 0]],
        [[4, 0], [8, 0], [8, 0.2], [8.3, 0.2], [8.3, 0], [12, 0], [12, 2]],
        [[12, 2], [8, 2]],
        [[7, 2], [5, 2], [5, 2.5], [4.2, 2.5], [4.2, 2], [0, 2], [0, 0]],
        [[3, 0], [2.5, 0], [2.5, -2.5], [5, -2.5], [5, -0.1], [4, 0]],
        [[7, 2], [6, 2.1], [6, 4.5], [9, 4.5], [9, 2.1], [8, 2]],
    ]
    scenario = {
        "seed": seed,
        "world": {"walls": walls, "doors": list(doors), "boxes": list(boxes)},
        "movers": list(movers),
        "robot": {"path": [[1, 1.1], [6, 1.0], [11, 1.1], [6, 0.9], [1, 1.1]], "repeat": repeat},
        "lasers": [{"beams": beams, "fov_deg": 240, "rate_hz": rate_hz, "max_range_m": 15}],
    }
    run = simulate(parse_scenario(scenario))
    return run, frame_of_scans(run.log, run.true_poses, 15.0, RESOLUTION_M)


def door(name, hinge, latch, angle, changes):
    """A door that opens and closes at these seconds, closed at first."""
    states = ["open", "closed"]
    schedule = [[0, "closed"], *([at, states[k % 2]] for k, at in enumerate(changes))]
    return {
        "name": name,
        "hinge": hinge,
        "latch": latch,
        "states": {"closed": 0, "open": angle},
        "schedule": schedule,
    }


def two_doors():
    """Both doors of the corridor, on schedules that differ; they change while the robot is far."""
    return [
        door("south", [3, 0], [4, 0], -90, [40, 95, 125]),
        door("north", [8, 2], [7, 2], -90, [28, 57, 85, 140]),
    ]


def shifted_poses(run, sigma_m, sigma_deg, hold_s=60.0, seed=0):
    """True poses with an error that hardly changes within a visit, as that of a SLAM."""
    draw = np.random.default_rng(seed)
    seconds = (run.log.stamps_ns - run.log.stamps_ns[0]) / 1e9
    knots = np.arange(int(seconds[-1] / hold_s) + 2)
    errors = draw.normal(size=(knots.size, 3)) * [sigma_m, sigma_m, np.deg2rad(sigma_deg)]
    at = np.stack([np.interp(seconds / hold_s, knots, errors[:, k]) for k in range(3)], axis=-1)
    return run.true_poses + at
