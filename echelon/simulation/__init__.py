"""A scenario, simulated frame by frame and recorded."""

from echelon.simulation.loop import Simulation, colors, resume, simulate

__all__ = ["Simulation", "colors", "resume", "simulate"]
