"""Side room: recordings with known truth. `load_scenario` reads a YAML file, `simulate` lets the robot drive."""

from dynmap_cli.simulation.run import SimulatedRun, simulate
from dynmap_cli.simulation.scenario import Scenario, load_scenario, parse_scenario

__all__ = ["Scenario", "SimulatedRun", "load_scenario", "parse_scenario", "simulate"]
