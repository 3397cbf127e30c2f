"""The round site by which a robot or a point mass meets walls and columns: soft, since walls are met seldom."""

from __future__ import annotations

from echelon.warp_kernels.model import ContactSite


def wall_bumper(name: str, link: str, radius: float) -> ContactSite:
    """A sphere of a radius [m] about a link's origin."""
    return ContactSite(
        name,
        link,
        (0.0, 0.0, 0.0),
        radii=(radius, radius, radius),
        surface="wall",
        stiffness=8_000.0,
        damping=300.0,
        tangential_stiffness=0.0,
        friction=0.2,
        integration="explicit",
        use="rare",
    )
