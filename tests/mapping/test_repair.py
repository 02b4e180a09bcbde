"""A wrong loop that nothing contradicts but free space is taken out; right maps are left as they are."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.mapping.back_end import close_loops
from dynmap_cli.mapping.edges import anchor_chain, loop_edges, scales
from dynmap_cli.mapping.graph_files import EDGES_HEADER, LOOPS_HEADER, write_graph
from dynmap_cli.mapping.local_maps import anchors_of, make_local_maps
from dynmap_cli.mapping.loops import Loop, LoopParams, LoopSearch
from dynmap_cli.mapping.pose_graph import join_edges, optimise
from dynmap_cli.mapping.repair import repair
from dynmap_cli.mapping.warnings import WRONG_MAP
from dynmap_cli.scan_matching.front_end import Registered
from dynmap_cli.scan_matching.sweeps import sweeps_of
from dynmap_cli.simulation import parse_scenario, simulate

RING = {
    "world": {
        "walls": [
            {"points": [[0, 0], [16, 0], [16, 12], [0, 12]], "closed": True},
            {"points": [[3, 3], [13, 3], [13, 9], [3, 9]], "closed": True},
            [[6, 0], [6, 1]],
            [[16, 5], [15, 5]],
            [[9, 12], [9, 11.2], [10, 11.2]],
            [[0, 7], [0.8, 7.6]],
        ]
    },
    "robot": {"path": [[1.5, 1.5], [14.5, 1.5], [14.5, 10.5], [1.5, 10.5], [1.5, 1.7], [14, 1.5], [14.4, 9]]},
    "lasers": [{"fov_deg": 270, "beams": 181, "max_range_m": 12, "rate_hz": 5, "noise_m": 0.01}],
}


@pytest.fixture(scope="module")
def ring():
    """A drive round a block; log, sweeps, rays, true poses, and the search with all right loops."""
    run = simulate(parse_scenario(RING))
    sweeps, rays = sweeps_of(run.log, None), rays_of(run.log, 30.0)
    poses = between(run.true_poses[0], run.true_poses)
    return run.log, sweeps, rays, poses


def searched(ring):
    _, sweeps, rays, poses = ring
    maps = make_local_maps(sweeps, rays, np.zeros_like(poses), np.arange(len(poses)), poses)
    anchors = anchors_of(maps)
    drives = np.zeros(len(poses), dtype=np.int32)
    chain, numbers = anchor_chain(poses, anchors, drives), np.arange(anchors.size)

    def solve(loops, start):
        edges = join_edges(chain, loop_edges(loops, numbers))
        return optimise(start, edges, scales(edges))[0]

    return LoopSearch(maps, LoopParams(), drives[anchors]), poses[anchors], solve


def test_a_right_map_is_left_as_it_is(ring):
    search, poses, solve = searched(ring)
    search.round(poses, 1.0)
    loops, said = list(search.loops), []
    np.testing.assert_array_equal(repair(search, poses, solve, said.append)[0], poses)
    assert search.loops == loops
    assert said == []


class InALargeSite(LoopSearch):
    """What contradicts is a small share, as elsewhere many more places are right."""

    def contradictions(self, poses):
        share, bad = super().contradictions(poses)
        return share / 1000, bad


def test_a_wrong_piece_of_a_large_site_is_repaired(ring):
    search, true, solve = searched(ring)
    search.round(true, 1.0)
    fit, last = search.loops[0].fit, len(true) - 20
    wrong = compose(between(true[last], true[1]), np.array([1.5, 2.0, 0.3]))
    large = InALargeSite(
        search.maps, LoopParams(), search.drives, [Loop(last, 1, replace(fit, pose=wrong), 0.0, 0.0)]
    )
    bent = solve(large.loops, true)
    assert large.contradictions(bent)[0] < 0.01
    repaired, _, bad = repair(large, bent, solve, lambda _: None)
    assert len(bad) < 3
    assert np.abs(repaired - true)[:, :2].max() < 0.3


@pytest.mark.parametrize("others_can_be_found", [True, False])
def test_a_wrong_loop_is_outvoted_or_taken_out(ring, others_can_be_found):
    search, true, solve = searched(ring)
    search.round(true, 1.0)
    fit, last = search.loops[0].fit, len(true) - 20
    wrong = compose(between(true[last], true[1]), np.array([1.5, 2.0, 0.3]))
    search.loops[:] = [Loop(last, 1, replace(fit, pose=wrong), 0.0, 0.0)]
    if not others_can_be_found:
        search.params = LoopParams(min_seen=2.0)
    bent = solve(search.loops, true)
    before, _ = search.contradictions(bent)
    assert before > WRONG_MAP
    repaired, share, bad = repair(search, bent, solve, lambda _: None)
    assert (share, bad) == search.contradictions(repaired)
    assert search.contradictions(repaired)[0] < before / 2
    assert np.abs(repaired - true)[:, :2].max() < 0.3
    if others_can_be_found:
        assert len(search.loops) > 1
    else:
        assert search.loops == []
        assert search.rejected[last, 1] == "contradicts free space"


def test_graph_files_name_every_edge_and_pair(ring, tmp_path):
    log, sweeps, rays, poses = ring
    n = len(poses)
    front = Registered(
        poses,
        np.ones(n),
        np.zeros((n, 3, 3)),
        np.zeros((n, 3)),
        np.ones(n, bool),
        np.zeros(n, bool),
        np.zeros(n, bool),
    )
    graph = close_loops(sweeps, rays, front, LoopParams(), lambda _: None)
    write_graph(tmp_path, log, graph)
    edges = (tmp_path / "edges.csv").read_text().splitlines()
    g2o = [line.split() for line in (tmp_path / "trajectory.g2o").read_text().splitlines()]
    assert edges[0] == EDGES_HEADER
    named = [line.split(",") for line in edges[1:]]
    assert [row[:2] for row in named] == [row[1:3] for row in g2o if row[0] == "EDGE_SE2"]
    assert {row[2] for row in named} <= {"chain", "loop", "dense"}
    assert all(0.0 <= float(row[6]) <= 1.0 for row in named)
    loops = [line.split(",") for line in (tmp_path / "loops.csv").read_text().splitlines()]
    assert ",".join(loops[0]) == LOOPS_HEADER
    assert sum(row[4] == "closed" for row in loops[1:]) == len(graph.loops) > 0
    assert sum(row[4] == "rejected" for row in loops[1:]) == len(graph.rejected)
    assert all((row[5] == "") == (row[4] == "closed") for row in loops[1:])
