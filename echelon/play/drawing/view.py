"""The live world in the browser: what stands still, sent once, and everybody who moves, sent every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import viser

from echelon.export.actor_looks import actor_visuals
from echelon.export.drawn_parts import DrawnPart, parts_of
from echelon.export.picture_source import DrawnCast, drawn_cast, drawn_world
from echelon.play.drawing.browser_light import light_up
from echelon.play.drawing.glb import glb
from echelon.play.drawing.moving import UNKNOWN_COLOR, MovingBodies, actor_name
from echelon.play.drawing.painted_parts import painted
from echelon.play.drawing.shadows import ActorShadow, Shadows, outline
from echelon.play.drawing.standing import Ground, Standing, standing_things
from echelon.recording import Actor, Cast

NEAREST = 0.25  # [m] from the eye: nothing nearer is drawn
WORLD = "/world"  # beneath it in the scene is what stands still
FARTHEST = {False: 2500.0, True: 12000.0}  # [m], in a field and on a road
SEEN_BELOW = 1.05  # [m]: what of an actor reaches higher is not drawn for who looks from its saddle


class View:
    """Draws a world and who moves in it for everybody who watches.

    Everything is sent through viser's scene: positions in metres relative to the world's origin, float32.

    Attributes:
        frame_rate: Frames a second.
        is_road: Whether the world is a road, along which those who move leave behind what they have seen.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        *,
        casts: Sequence[Cast],
        actors: Sequence[Actor],
        world: Mapping[str, Any],
        frame_rate: int,
    ) -> None:
        """Send everything that stands still, and what those look like who move.

        Args:
            server: viser's, which nobody else adds to the scene of.
            casts: The agents, see `echelon.recording.Cast`.
            actors: Who else is in the picture.
            world: Set pieces, as a recording has them.
            frame_rate: Frames a second.
        """
        self.frame_rate = frame_rate
        self._server = server
        drawn = drawn_world(world)
        self._ground = Ground(drawn)
        self.is_road = drawn.road is not None
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        server.initial_camera.near = NEAREST
        server.initial_camera.far = FARTHEST[self.is_road]
        light_up(server)
        self._world = server.scene.add_frame(WORLD, show_axes=False)
        for thing in standing_things(drawn):
            self._stand(thing)
        self._moving: MovingBodies | None = None
        self._crowd_shadows: list[tuple[slice, Shadows]] = []
        self._actor_shadows: list[ActorShadow] = []
        self._is_shown = False
        self.cast(casts, actors)

    @property
    def ridden_name(self) -> str:
        """The name in the scene of the first actor, who is ridden."""
        return actor_name(0)

    def ridden(self, from_saddle: bool) -> bytes:
        """The first actor, binary glTF; as its rider sees it, without what is at the height of the eyes and above."""
        highest = SEEN_BELOW if from_saddle else np.inf
        parts = [part for part in self._actors[0] if float(part.mesh.extent[1, 2]) < highest]
        return glb([painted(parts, np.array(UNKNOWN_COLOR))], shaded=True)

    def cast(self, casts: Sequence[Cast], actors: Sequence[Actor]) -> None:
        """Show other agents and actors from now on; the world stays."""
        self.clear()
        self._casts: list[DrawnCast] = [drawn_cast(cast) for cast in casts]
        self._actors: list[tuple[DrawnPart, ...]] = [parts_of(actor_visuals(actor)) for actor in actors]
        with self._server.atomic():
            self._moving = MovingBodies(self._server, self._casts, self._actors)

    def clear(self) -> None:
        """Take away everybody who moves; `cast` brings others."""
        with self._server.atomic():
            if self._moving is not None:
                self._moving.remove()
            for shadow in [*(shadows for _, shadows in self._crowd_shadows), *self._actor_shadows]:
                shadow.remove()
        self._moving, self._crowd_shadows, self._actor_shadows = None, [], []
        self._is_shown = False

    def show(
        self,
        link_poses: np.ndarray,
        actor_poses: np.ndarray,
        removed: np.ndarray | None = None,
        around: np.ndarray | None = None,
    ) -> None:
        """Show a frame.

        Args:
            link_poses: Of the agents' links in the world, x y z [m] and quaternion (x, y, z, w), shape
                [agents, links, 7].
            actor_poses: Of the actors likewise, shape [actors, 7].
            removed: Who has been taken away and is not seen, bool, shape [agents]; None where nobody is.
            around: What is to be where the world's origin is [m], shape [3], so that the world moves past a camera that
                stands still; None where the world stands still.

        Raises:
            RuntimeError: There is nobody to show: `clear` was called, and not `cast`.
        """
        if self._moving is None:
            raise RuntimeError("View.show() needs somebody to show: call cast() after clear()")
        here = np.zeros(3) if around is None else np.asarray(around, dtype=np.float64)
        roots = np.concatenate([link_poses[:, 0], actor_poses])
        planes = self._ground.planes(roots[:, :3])
        planes = np.column_stack([planes[:, :3], planes[:, 3] - planes[:, :3] @ here])
        shift = np.concatenate([here, np.zeros(4)])
        link_poses, actor_poses, roots = link_poses - shift, actor_poses - shift, roots - shift
        gone = np.zeros(len(roots), bool)
        if removed is not None:
            gone[: len(link_poses)] = removed
        with self._server.atomic():
            if not self._is_shown:
                self._throw(link_poses, actor_poses)
                self._is_shown = True
            self._world.position = -here
            self._moving.show(link_poses, actor_poses, removed)
            for members, shadows in self._crowd_shadows:
                shadows.show(roots[members], planes[members], gone[members])
            for shadow, pose, plane in zip(self._actor_shadows, actor_poses, planes[len(link_poses) :], strict=True):
                shadow.show(pose, plane)
        # Otherwise viser waits up to a sixtieth of a second for more.
        self._server.flush()

    def _stand(self, thing: Standing) -> None:
        scene, name, places = self._server.scene, f"{WORLD}/{thing.name}", thing.places
        if places is None:
            scene.add_glb(name, thing.model, cast_shadow=False, receive_shadow=False)
            return
        scene.add_batched_glb(
            name,
            thing.model,
            places.wxyzs,
            places.positions,
            batched_scales=places.scales,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _throw(self, link_poses: np.ndarray, actor_poses: np.ndarray) -> None:
        """Give everybody a shadow, with outlines as in a frame."""
        self._crowd_shadows = []
        for number, cast in enumerate(self._casts):
            first, count = cast.first_agent, len(cast.colors)
            if any(cast.links):
                body = outline(cast.links, link_poses[first])
                shadows = Shadows(self._server, f"/shadows/{number}", body, count)
                self._crowd_shadows.append((slice(first, first + count), shadows))
        self._actor_shadows = [
            ActorShadow(self._server, f"/shadows/actor-{number}", outline((parts,), actor_poses[number : number + 1]))
            for number, parts in enumerate(self._actors)
        ]
