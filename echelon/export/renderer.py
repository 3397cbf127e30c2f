"""The one place that speaks to pyrender and OpenGL: coloured triangles in, pixels out, no screen needed.

Light is worked out per vertex before it gets here (`echelon.export.light`), so that a software rasteriser has nothing
to do for a pixel but to interpolate a colour: 3.5 times as fast as pyrender's own physically based shader, whose
shadow maps fail with the PyOpenGL that it pins anyway.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from echelon.export.camera import View

if TYPE_CHECKING:
    from pyrender import Mesh, Node

NEAREST = 0.5  # [m] from the eye to the near plane, at least
FARTHEST = 3000.0  # [m] to the far plane; the sky is nearer


class RenderingUnavailable(RuntimeError):
    """This machine cannot draw pictures; the message is one line that says what to install."""


@dataclass(frozen=True)
class Surface:
    """Triangles with a colour at each vertex, shown as it is.

    Attributes:
        points: Vertices [m], float32, shape [n, 3].
        colors: Display-encoded RGB and opacity from 0 to 1, float32, shape [n, 4].
        triangles: Vertices of each triangle, counter-clockwise seen from where it is visible, shape [m, 3].
    """

    points: np.ndarray
    colors: np.ndarray
    triangles: np.ndarray

    @property
    def is_opaque(self) -> bool:
        return bool(np.all(self.colors[:, 3] >= 1.0))


def joined(surfaces: Sequence[Surface]) -> Surface:
    """One surface of several, drawn in their order; empty where there is none."""
    offsets = np.cumsum([0] + [len(surface.points) for surface in surfaces])
    return Surface(
        points=np.concatenate([np.empty((0, 3), np.float32), *[surface.points for surface in surfaces]]),
        colors=np.concatenate([np.empty((0, 4), np.float32), *[surface.colors for surface in surfaces]]),
        triangles=np.concatenate(
            [
                np.empty((0, 3), np.int32),
                *[surface.triangles + offset for surface, offset in zip(surfaces, offsets, strict=False)],
            ]
        ),
    )


class Renderer:
    """Draws surfaces into pictures of one size. Holds an OpenGL context; use it as a context manager.

    One at a time in a process: EGL's display is shared, and closing one renderer would end the other's.
    """

    def __init__(self, size: tuple[int, int], scenery: Sequence[Surface]) -> None:
        """Open a context and keep what does not move.

        Args:
            size: Width and height [pixels].
            scenery: Surfaces in every picture; where some are transparent, in the order in which they are drawn.

        Raises:
            RenderingUnavailable: There is no working OpenGL.
        """
        self._size = size
        self._pixels = np.empty((size[1], size[0], 3), dtype=np.uint8)
        try:
            self._open()
        # Whatever is missing (a library, a driver, a device) shows itself in a dozen ways, all of them somebody
        # else's: OSError, AttributeError, AssertionError, PyOpenGL's own. For the user they are one thing.
        except Exception as error:
            raise RenderingUnavailable(_unavailable(error)) from error
        self._scenery: list[Node] = []
        self.replace_scenery(scenery)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the context back; the renderer cannot draw any more."""
        self._offscreen.delete()

    def replace_scenery(self, scenery: Sequence[Surface]) -> None:
        """Keep other surfaces in every picture from now on, instead of those that were kept before."""
        for node in self._scenery:
            self._scene.remove_node(node)
        # Transparent scenery comes after what moves, so that it stays behind moving shadows.
        self._scenery = [
            self._add(surface, order=1 if surface.is_opaque else 3) for surface in scenery if len(surface.points)
        ]

    def draw(self, view: View, moving: Sequence[Surface]) -> np.ndarray:
        """One picture.

        Args:
            view: From where, to where; its eye must be above the ground, z > 0.
            moving: Surfaces of this picture only.

        Returns:
            RGB, uint8, shape [height, width, 3], the first row on top.
        """
        nodes = [self._add(surface, order=0 if surface.is_opaque else 2) for surface in moving if len(surface.points)]
        distance = float(np.linalg.norm(np.subtract(view.eye, view.target)))
        self._camera.yfov = view.field_of_view
        # As far out as it may be: what separates shadow layers is the depth buffer's resolution there.
        self._camera.znear = max(NEAREST, 0.1 * distance)
        self._scene.set_pose(self._camera_node, view.pose())
        rendered: Any = self._offscreen.render(self._scene, flags=self._flags)
        for node in nodes:
            self._scene.remove_node(node)
        return rendered[0]

    def _open(self) -> None:
        # EGL draws without a screen and beside one; pyrender's other way on Linux wants a window of a pyglet older
        # than the one that installs today. A choice that the user made stays.
        if sys.platform.startswith("linux"):
            os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
        import pyrender
        from pyrender.constants import RenderFlags

        self._pyrender = pyrender
        self._flags = RenderFlags.FLAT
        self._scene = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0))
        width, height = self._size
        self._camera = pyrender.PerspectiveCamera(yfov=1.0, znear=NEAREST, zfar=FARTHEST, aspectRatio=width / height)
        self._camera_node: Node = self._scene.add(self._camera)
        self._offscreen = pyrender.OffscreenRenderer(width, height)
        self._offscreen._renderer = _color_renderer(self._pixels)

    def _add(self, surface: Surface, order: int) -> Node:
        # pyrender keeps nodes in sets and draws the farthest first, solid ones before transparent ones. Equal
        # distances would leave the order to chance, so each rank gets its own depth below the ground; the
        # primitive is lifted by as much.
        depth = float(4 - order)
        pose = np.eye(4)
        pose[2, 3] = -depth
        return self._scene.add(self._mesh(surface, depth), pose=pose)

    def _mesh(self, surface: Surface, lift: float) -> Mesh:
        points = surface.points.astype(np.float32)
        points[:, 2] += np.float32(lift)
        material = self._pyrender.MetallicRoughnessMaterial(alphaMode="OPAQUE" if surface.is_opaque else "BLEND")
        return self._pyrender.Mesh(
            [
                self._pyrender.Primitive(
                    positions=points,
                    color_0=surface.colors,
                    indices=surface.triangles,
                    material=material,
                    mode=self._pyrender.GLTF.TRIANGLES,
                )
            ]
        )


def _color_renderer(pixels: np.ndarray) -> Any:
    """A pyrender renderer that reads back colours only, into one array: the depth picture costs a third of a frame."""
    from OpenGL import GL
    from pyrender.renderer import Renderer as PyrenderRenderer

    class ColorRenderer(PyrenderRenderer):
        def _read_main_framebuffer(self, scene: object, flags: int) -> tuple[np.ndarray, None]:
            width, height = self._main_fb_dims
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb_ms)
            GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._main_fb)
            GL.glBlitFramebuffer(
                0, 0, width, height, 0, 0, width, height, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST
            )  # averages the samples of each pixel
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, array=pixels)
            return pixels[::-1].copy(), None

    return ColorRenderer(pixels.shape[1], pixels.shape[0])


def _unavailable(error: Exception) -> str:
    texts = [part for part in error.args if isinstance(part, str)] or [str(error) or type(error).__name__]
    reason = " ".join(": ".join(texts).split())[:120]
    return (
        f"pictures need OpenGL through EGL, which does not work here ({reason}); "
        "on Debian and Ubuntu install libegl1 and libgl1-mesa-dri"
    )
