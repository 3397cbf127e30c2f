"""Desired velocities that depend on nobody: one for everybody, or random changes for each; for trying out a body."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def command_constant(
    first: int,
    # model
    velocity: wp.vec2,
    # out
    desired_out: wp.array[wp.vec2],
):
    """The same desired velocity [m/s] for everybody from the agent `first` on."""
    desired_out[first + wp.tid()] = velocity


@wp.kernel
def command_random(
    first: int,
    # model
    frame_in: wp.array[wp.int32],
    period: int,
    seed: int,
    change: float,
    max_speed: float,
    # state in and out
    commanded: wp.array[wp.vec2],
    # out
    desired_out: wp.array[wp.vec2],
):
    """Every `period` frames each one's desired velocity jumps by up to `change` [m/s], evenly over a disc.

    A jump that would lead beyond `max_speed` [m/s] ends at the nearest velocity within it, which makes it shorter.
    """
    agent = first + wp.tid()
    frame = frame_in[0]
    if frame % period == 0:
        # A stream of its own for each agent and change: nobody's depends on how many others there are.
        random = wp.rand_init(int(wp.rand_init(seed, frame // period)), agent)
        size = change * wp.sqrt(wp.randf(random))
        angle = wp.randf(random, 0.0, 6.2831853)
        asked = commanded[agent] + size * wp.vec2(wp.cos(angle), wp.sin(angle))
        commanded[agent] = asked * wp.min(1.0, max_speed / wp.max(wp.length(asked), 1.0e-6))
    desired_out[agent] = commanded[agent]
