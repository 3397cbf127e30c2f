"""Light and colour in the browser, so that what is seen there looks like the films.

viser's page shows everything through three.js's filmic tone mapping (the ACES fit by Stephen Hill), which brightens
what is dark and dulls what is bright. What is to be seen as it is must be given as that curve's inverse.
"""

from __future__ import annotations

import numpy as np
import viser

from echelon.export.light import BOUNCE_COLOR, SKY_COLOR, SUN, SUN_COLOR, display_encoded

# The tone mapping of three.js: its matrices are written by columns there.
_INTO = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_OUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_EXPOSURE = 1.0 / 0.6
_BRIGHTEST = 0.97  # of what the curve gives: it never quite reaches white

SUN_DISTANCE = 1000.0  # [m], a directional light shines from where it is towards the origin


def tone_mapped(shown: np.ndarray) -> np.ndarray:
    """What the page makes of linear RGB, linear again, shape [..., 3]."""
    value = (_EXPOSURE * np.asarray(shown, dtype=np.float64)) @ _INTO.T
    curve = (value * (value + 0.0245786) - 0.000090537) / (value * (0.983729 * value + 0.4329510) + 0.238081)
    return np.clip(curve @ _OUT.T, 0.0, 1.0)


def before_tone_mapping(linear: np.ndarray) -> np.ndarray:
    """Linear RGB that the page's tone mapping turns into the one wanted, shape [..., 3]; may be greater than 1."""
    curve = np.clip(np.asarray(linear, dtype=np.float64) @ np.linalg.inv(_OUT).T, 0.0, _BRIGHTEST)
    # The curve is a quotient of quadratic polynomials: solved for its argument.
    a = 1.0 - 0.983729 * curve
    b = 0.0245786 - 0.4329510 * curve
    c = -0.000090537 - 0.238081 * curve
    value = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    return np.maximum(value @ np.linalg.inv(_INTO).T / _EXPOSURE, 0.0)


def linear_of_display(encoded: np.ndarray) -> np.ndarray:
    """Linear RGB of sRGB values from 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def shown_as_is(encoded: np.ndarray) -> np.ndarray:
    """What to give for a surface without shading that is to be seen in display-encoded colours [..., 3]."""
    return before_tone_mapping(linear_of_display(np.asarray(encoded, dtype=np.float64)))


def shaded_albedo(albedo: np.ndarray) -> np.ndarray:
    """What to give for a shaded surface of some albedo, linear RGB [..., 3]: right between light and shade."""
    return np.clip(before_tone_mapping(albedo), 0.0, 1.0)


def light_up(server: viser.ViserServer) -> None:
    """The films' sun and sky instead of viser's own lights (`echelon.export.light.lit`)."""
    scene = server.scene
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    # three.js divides what a matt surface throws back by pi.
    x, y, z = (SUN_DISTANCE * SUN).tolist()
    brightest = float(SUN_COLOR.max())
    scene.add_light_directional(
        "/light/sun", color=_rgb(SUN_COLOR / brightest), intensity=np.pi * brightest, position=(x, y, z)
    )
    # Its direction is where it is, seen from the origin.
    scene.add_light_hemisphere(
        "/light/sky",
        sky_color=_rgb(SKY_COLOR),
        ground_color=_rgb(BOUNCE_COLOR),
        intensity=float(np.pi),
        position=(0.0, 0.0, 1.0),
    )


def _rgb(linear: np.ndarray) -> tuple[int, int, int]:
    red, green, blue = np.round(255.0 * display_encoded(np.asarray(linear))).astype(int).tolist()
    return red, green, blue
