"""A session: a world that is shown, the page that shows it, and the loop between them.

    people ── commands ──► what is shown (live or recorded) ── pictures ──► viser ── the same picture to everybody
       ▲                                                                      cameras ── to each an own point of view
       └──────────────────────── state (speed, place, who rides, ...) ─────── front

The loop runs at wall-clock pace (`pace`). viser listens on the loopback address only, behind the front.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from echelon.play.drawing.cameras import Cameras
from echelon.play.drawing.quiet_server import close_server, open_server
from echelon.play.drawing.view import View
from echelon.play.pace import Pace
from echelon.play.showing import Showing
from echelon.play.web.front import Front
from echelon.play.web.messages import ChangeView, Look

LOOPBACK = "127.0.0.1"


class Session:
    """People who watch something, together.

    Attributes:
        front: Where browsers come to.
        pace: Of the loop.
        pictures: How many have been shown so far.
    """

    def __init__(self, showing: Showing, *, host: str = LOOPBACK, port: int = 8080) -> None:
        """
        Args:
            showing: What they watch.
            host: Address to listen on.
            port: Port to listen on, or the next free one; 0 for any.
        """
        self._showing = showing
        self._server = open_server()
        self._view = View(
            self._server,
            casts=showing.casts,
            actors=showing.actors,
            world=showing.world,
            frame_rate=showing.frame_rate,
        )
        self._cameras = Cameras(self._server, self._view)
        self.front = Front(self._server.get_port(), showing.welcome, host=host, port=port)
        self.pace = Pace(showing.frame_rate)
        self.pictures = 0

    def run(self, stop: threading.Event, ready: Callable[[str], None] = lambda _: None) -> None:
        """Show until told to stop.

        Args:
            stop: Set it to end.
            ready: Called with the page's address once a browser may come.

        Raises:
            InputError: The address cannot be listened on.
        """
        try:
            self.front.start()
            ready(self.front.url)
            self.pace.restart()
            while not stop.is_set():
                self._hear()
                self._show()
                self.pace.wait()
        finally:
            self.front.stop()
            close_server(self._server)
            self._showing.close()

    def _hear(self) -> None:
        viewers = {person.id: person.viewer for person in self.front.people()}
        for person, command in self.front.commands():
            if isinstance(command, ChangeView):
                self._cameras.watch(viewers.get(person, -1), command.view)
            elif isinstance(command, Look):
                self._cameras.look(viewers.get(person, -1), command.yaw, command.pitch)
            elif self._showing.hear(command):
                self._view.cast(self._showing.casts, self._showing.actors)
                self.front.welcome = self._showing.welcome
                # Getting ready took its time, which is nobody's to make up for.
                self.pace.restart()

    def _show(self) -> None:
        moment = self._showing.picture()
        self._view.show(moment.links, moment.actors, moment.removed)
        self._cameras.update(moment.rider, moment.places)
        state = {"real_time": self.pace.real_time, "slow": self.pace.slow and not self._showing.standing_still}
        self.front.tell(state | self._showing.state())
        self.pictures += 1
