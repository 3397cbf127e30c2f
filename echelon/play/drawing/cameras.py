"""What each of those who watch sees: from the saddle, from behind, or from where they like.

The camera in the saddle is fixed to the bicycle, and so must the bicycle be to the camera: what everybody is sent and
what one person is sent travel in two streams, and a bicycle that is drawn a moment before or after its camera would
tremble. Who looks from the saddle, or from behind, therefore gets a bicycle of their own, sent together with the
camera; from the saddle without the head and the shoulders that they would look through.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import viser

from echelon.export.drawn_bodies import rotation_matrices
from echelon.play.drawing.view import View

Looking = Literal["saddle", "follow", "free"]

EYE = np.array([-0.15, 0.0, 1.25])  # [m] in the bicycle's frame: halfway between the wheels, on the ground
GAZE = 20.0  # [m] from the eye to the point that is looked at
DOWNWARD = 0.07  # [rad] that a rider looks down at the road
LEAN_SHARE = 1.0 / 3.0  # of the bicycle's lean that the horizon shows: a head stays more upright
STEEPEST = 1.35  # [rad] that anybody can look up or down
SADDLE_FIELD, OUTSIDE_FIELD = 1.15, 0.95  # [rad], fields of view, upright

# Time constants [s].
PITCH_TIME = 0.25
LEAN_TIME = 0.12
LOOK_TIME = 0.06
HEADING_TIME = 0.45  # of who is followed
PLACE_TIME = 0.12  # of who is followed
CROWD_PLACE_TIME = 0.2
CROWD_TIME = 1.2  # its size and heading

BEHIND, ABOVE = 6.5, 2.9  # [m] from who is followed to the camera
AHEAD, CHEST = 3.0, 0.9  # [m] from who is followed to what the camera looks at
CROWD_DISTANCES = (10.0, 45.0)  # [m] from a crowd to the camera, least and greatest
CROWD_SPREADS = 1.7  # times the crowd's radius
CROWD_SLOPE = 0.42  # [rad] that the camera looks down at it
WALKING = 0.5  # [m/s]: a crowd that is slower has no heading
UP = np.array([0.0, 0.0, 1.0])
FIRST_HEADING = np.array([0.35, 0.94])  # of the camera's view while there is no other


@dataclass
class _Watcher:
    """Somebody who watches.

    Attributes:
        looking: How.
        yaw, pitch: Where they turn their head, from straight ahead: left and up [rad].
        seen_yaw, seen_pitch: As it is shown, smoothly.
        is_placed: Whether a free camera has been given its first place.
        bicycle: Their own, while the camera moves with it.
        bicycle_for: How they looked when they got it.
    """

    client: viser.ClientHandle
    looking: Looking = "follow"
    yaw: float = 0.0
    pitch: float = 0.0
    seen_yaw: float = 0.0
    seen_pitch: float = 0.0
    is_placed: bool = False
    bicycle: viser.GlbHandle | None = field(default=None, repr=False)
    bicycle_for: Looking = "free"


@dataclass(frozen=True)
class Shot:
    """Where a camera is, where it looks [m], which way is up, and how much it sees, upright [rad]."""

    eye: np.ndarray
    target: np.ndarray
    up: np.ndarray
    field_of_view: float


class Cameras:
    """The cameras of all clients of a server."""

    def __init__(self, server: viser.ViserServer, view: View) -> None:
        """
        Args:
            server: Whose clients they are.
            view: What they look at; its first actor is who is ridden.
        """
        self._server, self._view = server, view
        self._step = 1.0 / view.frame_rate
        self._lock = threading.Lock()
        self._watchers: dict[int, _Watcher] = {}
        self._saddle = _Saddle(self._step)
        self._follow = _Follow(self._step)
        self._crowd = _CrowdShot(self._step)
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._gone)

    def watch(self, client_id: int, looking: Looking) -> None:
        """Let a client look in another way from now on; nobody is told where there is no such client.

        "free" is viser's own: it is placed once, so that it sees everything, and left alone.
        """
        with self._lock:
            watcher = self._watchers.get(client_id)
            if watcher is not None:
                watcher.looking, watcher.is_placed = looking, False

    def look(self, client_id: int, yaw: float, pitch: float) -> None:
        """Turn the head of somebody in the saddle: from straight ahead to the left and up [rad]."""
        with self._lock:
            watcher = self._watchers.get(client_id)
            if watcher is not None:
                watcher.yaw, watcher.pitch = float(yaw), float(np.clip(pitch, -STEEPEST, STEEPEST))

    def update(self, rider_pose: np.ndarray | None, places: np.ndarray | None = None) -> None:
        """Move the cameras to a new frame; once a frame, after `View.show`.

        Args:
            rider_pose: Of who is ridden, x y z [m] and quaternion (x, y, z, w), shape [7]; None where there is nobody:
                then the saddle is a view of the crowd too.
            places: Of the agents who are there [m], shape [n, 3]; None or none to leave them out.
        """
        crowd = None if places is None or not len(places) else np.asarray(places, dtype=np.float64)
        ridden = None if rider_pose is None else np.asarray(rider_pose, dtype=np.float64)
        there = [part for part in (None if ridden is None else ridden[None, :3], crowd) if part is not None]
        follow = None
        if ridden is not None:
            self._saddle.update(ridden)
            follow = self._follow.shot(ridden)
        if crowd is not None:
            wide = self._crowd.shot(crowd)
            follow = wide if follow is None else follow
        with self._lock:
            watchers = list(self._watchers.values())
        for watcher in watchers:
            watcher.seen_yaw = _towards(watcher.seen_yaw, watcher.yaw, self._step, LOOK_TIME)
            watcher.seen_pitch = _towards(watcher.seen_pitch, watcher.pitch, self._step, LOOK_TIME)
            with watcher.client.atomic():
                self._give_bicycle(watcher, ridden)
                if watcher.looking == "free":
                    if not watcher.is_placed and follow is not None:
                        _place(watcher.client, overview(np.concatenate(there)))
                        watcher.is_placed = True
                elif watcher.looking == "saddle" and ridden is not None:
                    shot = self._saddle.shot(ridden, watcher.seen_yaw, watcher.seen_pitch)
                    _place(watcher.client, shot)
                elif follow is not None:
                    _place(watcher.client, follow)
            watcher.client.flush()

    def _give_bicycle(self, watcher: _Watcher, pose: np.ndarray | None) -> None:
        """A bicycle of their own for those whose camera moves with it, under the name of the one that others see."""
        wanted = watcher.looking if pose is not None else "free"
        if watcher.bicycle is not None and watcher.bicycle_for != wanted:
            watcher.bicycle.remove()
            watcher.bicycle = None
        if pose is None or wanted == "free":
            return
        if watcher.bicycle is None:
            model = self._view.ridden(from_saddle=wanted == "saddle")
            watcher.bicycle = watcher.client.scene.add_glb(
                self._view.ridden_name, model, cast_shadow=False, receive_shadow=False
            )
            watcher.bicycle_for = wanted
        watcher.bicycle.position, watcher.bicycle.wxyz = pose[:3], pose[[6, 3, 4, 5]]

    def _connected(self, client: viser.ClientHandle) -> None:
        client.gui.add_html(_sign(client.client_id))
        with self._lock:
            self._watchers[client.client_id] = _Watcher(client)

    def _gone(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._watchers.pop(client.client_id, None)


def _sign(client_id: int) -> str:
    """What tells a page which client it is, and hides viser's own panel, in which it stands."""
    return (
        f'<div id="echelon-viewer" data-viewer="{client_id}"></div>'
        "<style>[data-floating-window]:has(#echelon-viewer),"
        ".mantine-ScrollArea-root:not([data-floating-window] *):has(#echelon-viewer)"
        "{visibility:hidden!important;pointer-events:none!important}</style>"
    )


# ---- shots ---------------------------------------------------------------------------------------------------------
class _Saddle:
    """The bicycle as a head on it feels it: its slope and lean, smoothly."""

    def __init__(self, step: float) -> None:
        self._step = step
        self._felt: tuple[float, float] | None = None

    def update(self, pose: np.ndarray) -> None:
        """Feel a new frame."""
        _, slope, lean = _attitude(pose)
        before = self._felt or (slope, lean)
        self._felt = (
            _towards(before[0], slope, self._step, PITCH_TIME),
            _towards(before[1], lean, self._step, LEAN_TIME),
        )

    def shot(self, pose: np.ndarray, yaw: float, pitch: float) -> Shot:
        """From the saddle of a bicycle, the head turned to the left and up [rad]."""
        heading, _, _ = _attitude(pose)
        slope, lean = self._felt or (0.0, 0.0)
        eye = pose[:3] + rotation_matrices(pose[3:]) @ EYE
        up = float(np.clip(slope - DOWNWARD + pitch, -STEEPEST, STEEPEST))
        aside = heading + yaw
        ahead = np.array([np.cos(up) * np.cos(aside), np.cos(up) * np.sin(aside), np.sin(up)])
        # Leaning is about the bicycle's own axis: who looks aside sees it as a slope.
        roll = LEAN_SHARE * lean
        right = np.array([np.sin(heading), -np.cos(heading), 0.0])
        return Shot(eye, eye + GAZE * ahead, np.array([0.0, 0.0, np.cos(roll)]) + np.sin(roll) * right, SADDLE_FIELD)


class _Follow:
    """From behind and above somebody."""

    def __init__(self, step: float) -> None:
        self._step = step
        self._place: np.ndarray | None = None
        self._ahead = np.zeros(2)

    def shot(self, pose: np.ndarray) -> Shot:
        heading, _, _ = _attitude(pose)
        ahead = np.array([np.cos(heading), np.sin(heading)])
        place = self._place
        if place is None or np.linalg.norm(pose[:3] - place) > BEHIND:  # a start, or another place
            place, self._ahead = pose[:3], ahead
        # The place is followed at once along the way, so that speed does not open a gap; aside and up it is smoothed.
        gap = pose[:3] - place
        along = np.array([*ahead, 0.0]) * float(gap[:2] @ ahead)
        self._place = place = place + along + (1.0 - np.exp(-self._step / PLACE_TIME)) * (gap - along)
        turned = self._ahead + (1.0 - np.exp(-self._step / HEADING_TIME)) * (ahead - self._ahead)
        self._ahead = turned / np.linalg.norm(turned) if np.linalg.norm(turned) > 1e-3 else ahead
        flat = np.array([*self._ahead, 0.0])
        eye = place - BEHIND * flat + [0.0, 0.0, ABOVE]
        return Shot(eye, place + AHEAD * flat + [0.0, 0.0, CHEST], UP, OUTSIDE_FIELD)


class _CrowdShot:
    """From behind and above a crowd, as far away as it is large."""

    def __init__(self, step: float) -> None:
        self._step = step
        self._middle: np.ndarray | None = None
        self._velocity = np.zeros(2)
        self._ahead = FIRST_HEADING / np.linalg.norm(FIRST_HEADING)
        self._radius = 0.0

    def shot(self, places: np.ndarray) -> Shot:
        middle, radius = _middle(places)
        before = self._middle
        if before is None or np.linalg.norm(middle - before) > CROWD_DISTANCES[0]:  # a start, or another place
            before, self._radius, self._velocity = middle, radius, np.zeros(2)
        share = 1.0 - np.exp(-self._step / CROWD_TIME)
        moved = (1.0 - np.exp(-self._step / CROWD_PLACE_TIME)) * (middle - before)
        self._middle = seen = before + moved
        self._radius += share * (radius - self._radius)
        self._velocity += share * (moved[:2] / self._step - self._velocity)
        speed = float(np.linalg.norm(self._velocity))
        if speed > WALKING:
            turned = self._ahead + share * (self._velocity / speed - self._ahead)
            self._ahead = turned / max(float(np.linalg.norm(turned)), 1e-6)
        return _looking_down(seen, self._ahead, self._radius, CROWD_DISTANCES[1])


def overview(places: np.ndarray) -> Shot:
    """Of everybody who is at some places [m], shape [n, 3], at least one, from above."""
    middle, radius = _middle(places)
    return _looking_down(middle, FIRST_HEADING / np.linalg.norm(FIRST_HEADING), 1.3 * radius, 120.0)


def _middle(places: np.ndarray) -> tuple[np.ndarray, float]:
    """The middle of a crowd, and the radius within which three quarters of it are [m]."""
    middle = np.median(places, axis=0)
    return middle, float(np.quantile(np.linalg.norm(places - middle, axis=1), 0.75))


def _looking_down(middle: np.ndarray, ahead: np.ndarray, radius: float, farthest: float) -> Shot:
    distance = float(np.clip(CROWD_SPREADS * radius + 0.5 * CROWD_DISTANCES[0], CROWD_DISTANCES[0], farthest))
    away = np.array([*(-np.cos(CROWD_SLOPE) * ahead), np.sin(CROWD_SLOPE)])
    return Shot(middle + distance * away, middle, UP, OUTSIDE_FIELD)


def _attitude(pose: np.ndarray) -> tuple[float, float, float]:
    """Heading from x towards y, slope upwards, and lean to the right of a pose [rad]."""
    forward, left, _ = rotation_matrices(pose[3:]).T
    heading = float(np.arctan2(forward[1], forward[0]))
    return heading, float(np.arcsin(np.clip(forward[2], -1.0, 1.0))), float(np.arcsin(np.clip(left[2], -1.0, 1.0)))


def _towards(value: float, goal: float, step: float, time: float) -> float:
    """A value a step [s] later on its way to a goal, with a time constant [s]."""
    return goal + (value - goal) * float(np.exp(-step / time))


def _place(client: viser.ClientHandle, shot: Shot) -> None:
    camera = client.camera
    camera.up_direction = shot.up
    camera.position = shot.eye
    camera.look_at = shot.target
    camera.fov = shot.field_of_view
