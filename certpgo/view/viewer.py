"""A scene in the browser, live or as one offline file, drawn by viser."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import MissingDependency
from certpgo.graph.kinds import PRIORS, Kind
from certpgo.io.exact import quaternion
from certpgo.io.surfaces import Surface, glb
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.view.caption import (
    LANDMARKS,
    OUTLINES,
    PRIOR_DOTS,
    REJECTED,
    legend,
    overlay,
    truth_ink,
)
from certpgo.view.scene import Placement, Rgb, Scene, colours

#: The scene's extent in the browser, whose camera and controls are made for it.
EXTENT = 10.0
#: Vertical field of view, radians, and the width over height that is framed.
FIELD, ASPECT = 0.7, 1.5
#: How far from straight above a scene is seen, radians: in space, and if it is flat.
TILT, FLAT = 0.7, 0.02
#: Points from which on coordinates have half precision, which halves the file.
MANY = 100_000
#: Steps and seconds of a walk along the trajectory.
STEPS, SECONDS = 300, 15.0
#: Port that is tried first.
PORT = 8080

#: Whether the reader's system is dark, in a page.
_SYSTEM = 'matchMedia("(prefers-color-scheme: dark)").matches'
#: Widths of lines, pixels.
_WIDTHS = {"steps": 2.5, "loop closures": 1.5, "sightings": 0.5, "distances": 0.5}


def offline(
    scene: Scene, *, dark: bool | None = None, colour: str | None = None, play: bool = False
) -> str:
    """A scene as one HTML file that needs no network; layers are switched in its scene tree.

    Parameters
    ----------
    dark : whether the background is dark; by default as the reader's system is
    colour : unit of the measure that colours edges, such as ``"degrees"``; the first by default
    play : whether a frustum walks along the trajectory

    Raises
    ------
    InputError
        No edge has such a measure.
    MissingDependency
        viser is not installed.
    """
    with serving("127.0.0.1", PORT) as server:
        drawing = Drawing(server, scene, dark=dark, colour=colour)
        recording = server.get_scene_serializer()
        if play:
            steps = drawing.walk_length
            for step in range(0, steps, max(1, steps // STEPS)):
                drawing.walk_to(step)
                recording.insert_sleep(SECONDS / min(steps, STEPS))
        page: str = recording.as_html(dark_mode=bool(dark))
    if dark is None:
        page = page.replace("{darkMode:false}", f"{{darkMode:{_SYSTEM}}}", 1)
    caption = overlay(scene, scene.unit(colour), dark)
    page = f"{caption}</body>".join(page.rsplit("</body>", 1))
    return page.replace("<title>Viser</title>", f"<title>{html.escape(scene.name)}</title>", 1)


@contextmanager
def serving(host: str, port: int) -> Iterator[Any]:
    """A server of viser's while the block runs, which prints nothing."""
    try:
        import viser
    except ImportError:
        raise MissingDependency("viser", "view") from None
    with redirect_stdout(StringIO()):  # it prints its address however quiet it is asked to be
        server = viser.ViserServer(host=host, port=port, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


class Drawing:
    """A scene given to a viser server, in the frame of its box: z towards the viewer.

    Attributes
    ----------
    layers : viser's handles of what can be hidden, by name
    walk_length : number of poses of the answer
    """

    def __init__(self, server: Any, scene: Scene, *, dark: bool | None, colour: str | None) -> None:
        self._server, self._scene, self._dark = server, scene, dark
        self._scale = EXTENT / scene.frame.extent
        self._coloured: list[tuple[Any, Placement, BoolArray]] = []
        self.layers: dict[str, Any] = {}
        self.units = scene.units
        self._unit = scene.unit(colour)
        answer = scene.placements[-1] if scene.placements else None
        for number, placement in enumerate(reversed(scene.placements)):
            self._add_estimate(placement, _ink(number, dark), shown=placement is answer)
        if scene.truth is not None:
            self._add_truth(scene.truth)
        for outlines in scene.outlines:
            ink = OUTLINES[outlines.name]
            self._layer(outlines.name, shown=False)
            if len(rings := self._placed(outlines.wires())):
                self._lines(f"/{outlines.name}/rings", rings, ink, 1.0)
        for name, surface in scene.surfaces:
            self._add_surface(name, surface)
        self._add_scale()
        self._aim()
        self._answer = answer
        self._walk = np.zeros(0, dtype=np.intp) if answer is None else scene.poses(answer)
        self.walk_length = len(self._walk)
        self._walker: Any = None

    def recolour(self, unit: str) -> None:
        """Colour edges by another measure."""
        self._unit = unit
        for handle, placement, drawn in self._coloured:
            handle.colors = self._colours(placement, drawn)

    def walk_to(self, step: int) -> None:
        """Mark the pose at a place 0 ... walk_length - 1 of the trajectory."""
        answer = self._answer
        if answer is None or not self.walk_length:
            return
        row = self._walk[step]
        axes = self._scene.frame.axes
        turn = quaternion.to_write((axes @ answer.rotations[row])[None])[0]
        if self._walker is None:
            lines = 2.5 * self._scale * self._scene.frustum_lines
            ink = (255, 120, 60)
            self._walker = self._lines("/walker", lines, ink, 4.0)
        self._walker.wxyz = turn[[3, 0, 1, 2]]
        self._walker.position = self._placed(answer.positions[row])

    @contextmanager
    def controls(self) -> Iterator[None]:
        """Boxes for layers, a choice of colours, and a walk that plays, while the block runs."""
        gui, ended = self._server.gui, threading.Event()
        gui.configure_theme(dark_mode=bool(self._dark), show_logo=False, show_share_button=False)
        gui.set_panel_label(self._scene.name)
        said = [
            self._scene.verdict,
            *(text for _, text in legend(self._scene, self._unit, self._dark)),
        ]
        gui.add_markdown("\n\n".join(filter(None, said)))
        for name, handle in self.layers.items():
            box = gui.add_checkbox(name, initial_value=handle.visible)
            box.on_update(_switching(handle))
        if self.units:
            choice = gui.add_dropdown("colour by", self.units, initial_value=self._unit)
            choice.on_update(lambda event: self.recolour(event.target.value))
        walking = None
        if self.walk_length > 1:
            place = gui.add_slider("pose", 0, self.walk_length - 1, 1, 0)
            place.on_update(lambda event: self.walk_to(int(event.target.value)))
            playing = gui.add_checkbox("play", initial_value=False)
            arguments = (ended, playing, place, self.walk_length)
            walking = threading.Thread(target=_play, args=arguments, daemon=True)
            walking.start()
        try:
            yield
        finally:
            ended.set()
            if walking is not None:
                walking.join()

    def _placed(self, points: FloatArray) -> FloatArray:
        """World points (..., 3) in the browser."""
        frame = self._scene.frame
        return np.asarray(self._scale * (points - frame.centre) @ frame.axes.T)

    def _lines(self, name: str, ends: FloatArray, ink: Any, width: float) -> Any:
        return self._server.scene.add_line_segments(
            name, ends, ink, thickness=width, thickness_units="screen"
        )

    def _layer(self, name: str, *, shown: bool) -> None:
        self.layers[name] = self._server.scene.add_frame(f"/{name}", show_axes=False, visible=shown)

    def _add_estimate(self, placement: Placement, ink: Rgb, *, shown: bool) -> None:
        scene, name = self._scene, placement.name
        self._layer(name, shown=shown)
        layers = scene.are_steps, scene.are_loops, scene.are(Kind.SIGHTING), scene.are(Kind.RANGE)
        for chosen, (layer, width) in zip(layers, _WIDTHS.items(), strict=True):
            drawn = chosen & ~scene.rejected & scene.joins(placement)
            self._add_edges(f"/{name}/{layer}", placement, drawn, width)
        rejected = scene.ends(placement, scene.rejected & scene.joins(placement))
        if len(rejected):
            self._lines(f"/{name}/rejected", self._placed(rejected), REJECTED, 2.0)
        if not len(scene.edges) and len(placement.nodes) > 1:
            self._lines(f"/{name}/steps", self._placed(scene.steps(placement)), ink, 2.5)
        self._add_poses(placement, ink)
        self._add_marks(placement)

    def _add_edges(self, name: str, placement: Placement, drawn: BoolArray, width: float) -> None:
        if not drawn.any():
            return
        ends = self._placed(self._scene.ends(placement, drawn))
        handle = self._lines(name, ends, self._colours(placement, drawn), width)
        self._coloured.append((handle, placement, drawn))

    def _colours(self, placement: Placement, drawn: BoolArray) -> NDArray[np.uint8]:
        """(e, 2, 3) colours of both ends of edges."""
        chosen = self._scene.colours(placement, self._unit, drawn, dark=self._dark)
        return np.repeat(chosen[:, None], 2, axis=1)

    def _add_poses(self, placement: Placement, ink: Rgb) -> None:
        lines = self._placed(self._scene.frusta(placement))
        if len(lines):
            self._lines(f"/{placement.name}/poses", lines, ink, 1.0)

    def _add_marks(self, placement: Placement) -> None:
        """Landmarks and priors as dots, start and end with their names."""
        scene, size = self._scene, 0.4 * self._scale * self._scene.frustum
        everywhere = placement.spread(len(scene.ids))
        dots = {
            "landmarks": (everywhere[scene.landmarks], LANDMARKS),
            "priors": (scene.ends(placement, scene.are(*PRIORS))[:, 0], PRIOR_DOTS),
        }
        for name, (points, ink) in dots.items():
            points = points[np.isfinite(points).all(axis=1)]
            if len(points):
                self._add_points(f"/{placement.name}/{name}", points, ink, size)
        ends = scene.poses(placement)[[0, -1]] if len(scene.poses(placement)) > 1 else ()
        for name, row in zip(("start", "end"), ends, strict=False):
            place = self._placed(placement.positions[row])
            self._server.scene.add_label(f"/{placement.name}/{name}", name, position=place)

    def _add_truth(self, truth: Placement) -> None:
        ink = truth_ink(self._dark)
        self._layer("truth", shown=True)
        steps = self._scene.steps(truth)
        if len(steps):
            self._lines("/truth/steps", self._placed(steps), ink, 1.2)

    def _add_points(self, name: str, points: FloatArray, ink: Any, size: float) -> Any:
        precision = "float16" if len(points) >= MANY else "float32"
        return self._server.scene.add_point_cloud(
            name,
            self._placed(points),
            ink,
            point_size=size,
            point_shape="circle",
            precision=precision,
            point_shading="flat",
        )

    def _add_surface(self, name: str, surface: Surface) -> None:
        points, ink = surface.points, surface.colours
        if ink is None:
            height = self._placed(points)[:, 2]
            low, high = height.min(initial=0.0), height.max(initial=0.0)
            ink = colours((height - low) / max(high - low, 1e-12), dark=bool(self._dark))
        if len(surface.faces):
            data = glb(Surface(self._placed(points), ink, surface.faces))
            self.layers[name] = self._server.scene.add_glb(f"/{name}", data)
        elif len(points):
            size = float(np.clip(EXTENT / np.sqrt(len(points)), 0.01, 0.1))
            self.layers[name] = self._add_points(f"/{name}", points, ink, size)

    def _add_scale(self) -> None:
        """The world's axes and a bar of a round length at the corner of the box."""
        scene = self._scene
        if not scene.metric:
            return
        corner = scene.frame.corner
        length = scene.bar
        ends = corner + length * np.stack([np.zeros(3), scene.frame.axes[0]])
        self._layer("scale", shown=True)
        grey = (
            (130, 130, 130)
            if self._dark is None
            else (190, 190, 190)
            if self._dark
            else (90, 90, 90)
        )
        self._lines("/scale/bar", self._placed(ends)[None], grey, 3.0)
        place = self._placed(ends[1])
        label = f"{length:g} {scene.length_unit}"
        self._server.scene.add_label("/scale/length", label, position=place)
        turn = quaternion.to_write(scene.frame.axes[None])[0][[3, 0, 1, 2]]
        reach = self._scale * 0.5 * length
        self._server.scene.add_frame(
            "/scale/axes",
            wxyz=turn,
            position=self._placed(corner),
            axes_length=reach,
            axes_radius=0.03 * reach,
        )

    def _aim(self) -> None:
        """Place the camera as near as it sees everything from."""
        scene = self._scene
        tilt = FLAT if scene.is_flat else TILT
        camera = np.array(
            [[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]]
        )
        shown = [placement.positions for placement in scene.placements[-1:]]
        shown += [scene.frusta(placement).reshape(-1, 3) for placement in scene.placements[-1:]]
        shown += [surface.points for _, surface in scene.surfaces]
        x, y, z = (self._placed(np.concatenate([*shown, scene.frame.corner[None]])) @ camera.T).T
        reach = np.maximum(np.abs(y), np.abs(x) / ASPECT) / np.tan(0.5 * FIELD)
        distance = 1.08 * float((z + reach).max()) + 0.1
        view = self._server.initial_camera
        view.fov, view.look_at, view.position = FIELD, np.zeros(3), distance * camera[2]


def _ink(number: int, dark: bool | None) -> Rgb:
    """Colours of estimates, the answer's first."""
    light = ((0, 114, 178), (200, 90, 0), (160, 67, 138), (107, 91, 0))
    bright = ((86, 180, 233), (240, 145, 74), (229, 155, 208), (232, 211, 74))
    return (bright if dark else light)[number % len(light)]


def _switching(handle: Any) -> Callable[[Any], None]:
    def switch(event: Any) -> None:
        handle.visible = event.target.value

    return switch


def _play(ended: threading.Event, playing: Any, place: Any, length: int) -> None:
    """Move the slider while it plays."""
    while not ended.wait(SECONDS / STEPS):
        if playing.value:
            place.value = (place.value + max(1, length // STEPS)) % length
