"""A scenario, simulated frame by frame and recorded."""

from echelon.simulation.cost import RunCost
from echelon.simulation.loop import Simulation
from echelon.simulation.recorded import colors, resume, simulate

__all__ = ["RunCost", "Simulation", "colors", "resume", "simulate"]
