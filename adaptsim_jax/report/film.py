"""Films of trials: rendered by MuJoCo off screen, or drawn where no OpenGL works. A scene a task
says what is seen.

MuJoCo chooses its OpenGL when it is imported, and a driver that does not fit may end the process.
It is therefore asked in a process of its own, `python -m adaptsim_jax.report.film HOME clips.npz
film.mp4`, once for each kind of OpenGL that may be there.
"""

import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.files import output_errors

Array = Any
RENDER_SECONDS = 300.0  # s that a rendered film may take
BAND = 36  # pixels of a white band above a rendered picture, on which text shows


class Moment(NamedTuple):
    """One picture of a clip: the row of its arrays, its time in s, and a line of text."""

    row: int
    time: float
    text: str


class Stage(NamedTuple):
    """A clip in MuJoCo. `place(data, row)` puts its bodies there. camera: Of a row, a number of the
    model's or an `MjvCamera`. marks: What is added to the scene and touches nothing. band: Whether
    text stands above the picture instead of in it.
    """

    model: Any
    place: Callable[[Any, int], None]
    camera: Callable[[int], Any]
    marks: Callable[[Any, int], None] | None = None
    band: bool = False


@dataclass(frozen=True)
class Scene:
    """How trials of one kind are filmed.

    home: Where this record stands, `package.module:NAME`. name: The film's, without its suffix.
    clip: A dataclass of arrays and text, one trial. size: Width and height in pixels, both even.
    hold: Frames for which the end of a clip stays. fps: Frames a second of a film of clips.
    moments: A clip's pictures. drawing: `(clip) -> (moment) -> figure` of matplotlib, seen from
    `side`. stage: The clip in MuJoCo.
    """

    home: str
    name: str
    clip: type
    size: tuple[int, int]
    hold: int
    fps: Callable[[Sequence[Any]], float]
    moments: Callable[[Any], list[Moment]]
    drawing: Callable[[Any], Callable[[Moment], Any]]
    side: str
    stage: Callable[[Any], Stage]


def captioned(moment: Moment, left: float, right: float, height: float) -> Any:
    """Begin a drawing of 640 by 360 pixels with the moment's text and time.

    Args:
        left, right, height: Shares of the figure, where the text begins, the time ends and both
            stand.

    Returns:
        The figure, to which axes are added.
    """
    from matplotlib.figure import Figure

    from adaptsim_jax.report import figures as look

    figure = Figure(figsize=(6.4, 3.6), dpi=100, facecolor="white")
    figure.text(left, height, moment.text, fontsize=11, color=look.INK)
    time = f"{moment.time:.2f} s"
    figure.text(right, height, time, fontsize=11, color=look.MUTED, ha="right")
    return figure


def write_film(scene: Scene, clips: Sequence[Any], folder: Path) -> tuple[Path, str]:
    """`(path, how)`: the film in `folder`, mp4 with the extra `[video]`, else gif; and a line that
    says what drew it.
    """
    path = folder / f"{scene.name}{best_suffix()}"
    for kind in opengl_kinds():
        if rendered(scene, clips, path, kind):
            return path, f"rendered by MuJoCo ({kind or 'default OpenGL'})"
    write_video(drawn_frames(scene, clips), path, scene.fps(clips))
    tried = ", ".join(kind or "the default" for kind in opengl_kinds())
    how = f"no OpenGL for MuJoCo here (tried {tried}; set MUJOCO_GL to choose)"
    return path, f"drawn from {scene.side}: {how}"


def opengl_kinds() -> list[str]:
    """What MUJOCO_GL may be: the user's word where there is one, else what needs no screen."""
    if given := os.environ.get("MUJOCO_GL"):
        return [given]
    if sys.platform.startswith("linux"):
        return ["egl", "osmesa"]
    return [""]


def rendered(scene: Scene, clips: Sequence[Any], path: Path, kind: str) -> bool:
    """Whether a process of its own, with OpenGL of that kind, made the film at `path`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "clips.npz"
        arrays = {
            f"{key}_{i}": np.asarray(getattr(clip, key))
            for i, clip in enumerate(clips)
            for key in scene.clip.__annotations__
        }
        np.savez(file, allow_pickle=False, **arrays)
        environment = os.environ | ({"MUJOCO_GL": kind, "PYOPENGL_PLATFORM": kind} if kind else {})
        command = [sys.executable, "-m", __name__, scene.home, str(file), str(path)]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, timeout=RENDER_SECONDS, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            return False
    return done.returncode == 0 and path.exists()


def main(home: str, file: str, path: str) -> None:
    """The process that `rendered` starts; any error ends it with a code other than 0."""
    module, name = home.split(":")
    scene: Scene = getattr(importlib.import_module(module), name)
    with np.load(file, allow_pickle=False) as data:
        keys = list(scene.clip.__annotations__)
        count = sum(each.startswith(f"{keys[0]}_") for each in data.files)
        clips = [scene.clip(*(data[f"{key}_{i}"] for key in keys)) for i in range(count)]
    write_video(rendered_frames(scene, clips), Path(path), scene.fps(clips))
    sys.stdout.flush()
    # OpenGL contexts that end after their driver complain or crash; the film is whole by now
    os._exit(0)


def pictures_of(
    scene: Scene, clip: Any, picture: Callable[[Moment], np.ndarray]
) -> Iterator[np.ndarray]:
    """The frames of a clip; the last picture stays."""
    *before, last = scene.moments(clip)
    for moment in before:
        yield picture(moment)
    yield from [picture(last)] * scene.hold


def drawn_frames(scene: Scene, clips: Sequence[Any]) -> Iterator[np.ndarray]:
    """`[H, W, 3]` uint8 frames by matplotlib."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    for clip in clips:
        draw = scene.drawing(clip)

        def picture(moment: Moment, draw=draw) -> np.ndarray:
            canvas = FigureCanvasAgg(draw(moment))
            canvas.draw()
            return np.asarray(canvas.buffer_rgba())[..., :3].copy()

        yield from pictures_of(scene, clip, picture)


def rendered_frames(scene: Scene, clips: Sequence[Any]) -> Iterator[np.ndarray]:
    """`[H, W, 3]` uint8 frames by MuJoCo."""
    mujoco: Any = importlib.import_module("mujoco")
    width, height = scene.size
    for clip in clips:
        stage = scene.stage(clip)
        band = np.full((BAND if stage.band else 0, width, 3), 255, np.uint8)
        data = mujoco.MjData(stage.model)
        renderer = mujoco.Renderer(stage.model, height - len(band), width)

        def picture(
            moment: Moment, stage=stage, band=band, data=data, renderer=renderer
        ) -> np.ndarray:
            stage.place(data, moment.row)
            mujoco.mj_forward(stage.model, data)
            renderer.update_scene(data, stage.camera(moment.row))
            if stage.marks is not None:
                stage.marks(renderer.scene, moment.row)
            return with_text(np.concatenate([band, renderer.render()]), moment)

        yield from pictures_of(scene, clip, picture)
        renderer.close()


def camera(azimuth: float, elevation: float, distance: float, lookat: Array) -> Any:
    """MuJoCo's free camera; degrees and m."""
    mujoco: Any = importlib.import_module("mujoco")
    made = mujoco.MjvCamera()
    made.azimuth, made.elevation, made.distance = azimuth, elevation, distance
    made.lookat[:] = lookat
    return made


def light(model: Any, ambient: float, diffuse: float) -> None:
    """Even light from where the camera is, as in a room; nothing shines."""
    head = model.vis.headlight
    head.ambient[:], head.diffuse[:], head.specular[:] = ambient, diffuse, 0.0


def with_text(frame: np.ndarray, moment: Moment) -> np.ndarray:
    """`frame` with the moment's text at its upper left and its time at its upper right."""
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(frame)
    brush = ImageDraw.Draw(image)
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    font = ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), 16)
    brush.text((14, 10), moment.text, fill=(32, 38, 46), font=font)
    right = (frame.shape[1] - 14, 10)
    brush.text(right, f"{moment.time:.2f} s", fill=(70, 80, 92), font=font, anchor="ra")
    return np.asarray(image)


def best_suffix() -> str:
    """`.mp4` where it can be written here, else `.gif`."""
    if importlib.util.find_spec("imageio_ffmpeg"):
        return ".mp4"
    return ".gif"


def write_video(frames: Iterable[np.ndarray], path: Path, fps: float) -> Path:
    """Write `frames`, each `[H, W, 3]` uint8 with even H and W, to `path` (.mp4 or .gif), which
    appears whole or not at all.
    """
    writer = {".mp4": _mp4, ".gif": _gif}[path.suffix]
    with output_errors(path):
        handle, temporary = tempfile.mkstemp(
            prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        try:
            writer(frames, temporary, fps)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    return path


def _mp4(frames: Iterable[np.ndarray], path: str, fps: float) -> None:
    ffmpeg: Any = importlib.import_module("imageio_ffmpeg")
    writer = None
    try:
        for frame in frames:
            if writer is None:
                writer = ffmpeg.write_frames(
                    path,
                    frame.shape[1::-1],
                    fps=fps,
                    quality=8,
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                )
                _start(writer)
            writer.send(np.ascontiguousarray(frame))
    finally:
        if writer is not None:
            writer.close()


def _start(writer: Any) -> None:
    """JAX warns of the fork, whose child is the encoder at once."""
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning
        )
        writer.send(None)


def _gif(frames: Iterable[np.ndarray], path: str, fps: float) -> None:
    """One palette for all, or still parts flicker; of the widest cover, or small marks lose their
    colour. No dithering, which would crawl. It is taken from a few pictures at once.
    """
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    few = np.concatenate([np.asarray(image) for image in images[:: max(len(images) // 4, 1)]])
    palette = Image.fromarray(few).quantize(
        256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    flat = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    flat[0].save(
        path,
        save_all=True,
        append_images=flat[1:],
        duration=round(1000 / fps),
        loop=0,
        optimize=False,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
