"""`dynmap info`."""

import json

from click.testing import CliRunner

from dynmap_cli.cli import main
from tests.ingest.written import World, write_bag1


def test_info_shows_topics_lasers_and_decisions(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World())
    result = CliRunner().invoke(main, ["info", str(path)])
    assert result.exit_code == 0, result.output
    words = [line.split() for line in result.stdout.splitlines()]
    assert ["/scan", "sensor_msgs/msg/LaserScan", "12"] in words
    assert ["/scan", "laser", "12", "9", "128.9", "8", "10.0", "0.200", "-0.100", "0.000", "yes"] in words
    assert ["robot", "base_link"] in words
    assert "odometry: tf odom -> base_link" in result.stdout


def test_info_as_json_is_the_report(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World())
    result = CliRunner().invoke(main, ["info", str(path), "--json"])
    found = json.loads(result.stdout)
    assert found["scans"] == 12
    assert found["lasers"][0]["name"] == "/scan"
    assert {"name": "/odom", "kind": "nav_msgs/msg/Odometry", "count": 12} in found["recordings"][0]["topics"]


def test_info_on_a_recording_without_laser_still_shows_its_topics(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World(with_scans=False))
    result = CliRunner().invoke(main, ["info", str(path)])
    assert result.exit_code == 4
    assert "nav_msgs/msg/Odometry" in result.stdout
    assert "no laser scans" in result.stderr
